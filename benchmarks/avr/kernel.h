/* The tick of the board for an ATmega2560 at 16 MHz: one base period, 640 cycles.
 *
 * A frame is eight base periods. Each one puts out its port word and does one eighth of the frame's work:
 *
 *     period   0        1        2        3        4        5             6              7
 *     work     motor 0  motor 1  motor 2  motor 3  motor 4  motion time   inputs, hand   the words of the next frame
 *
 * A motor keeps, instead of position and count, the count and the lag p + 1/2 - count: the lag is small, so its whole part needs
 * one byte, and the step rule becomes "whole part of lag is not 0". The sum of both is the position, bit for bit. The port
 * words of a frame are put together once, so all motors change their levels in the same frame and a word costs only four loads and stores.
 */
#ifndef KERNEL_H
#define KERNEL_H

#include <stdint.h>

#ifndef CUBIC
#define CUBIC 1
#endif

#define MOTORS 5
#define SLOTS 4
#define PERIODS 8
#define QUEUE_SLOTS 32
#define DEBOUNCE_BITS 4 /* up to 15 frames; a configuration with more takes more bits */

/* The terms of one motor in one segment, as wide as they get while it plays: the tick works on them in their place in the queue, so
 * that nothing has to be copied when a segment begins. */
typedef struct {
    uint8_t v[6]; /* s48, 2^-48 step/frame */
    uint8_t a[5]; /* s40, 2^-48 step/frame^2 */
#if CUBIC
    uint8_t j[4]; /* s32, 2^-48 step/frame^3 */
#endif
} terms_t;

typedef struct {
    uint8_t lag[6]; /* 2^-48 step: the fraction .. */
    int8_t whole;   /* .. and the whole part */
    uint8_t dir;    /* 1 = negative */
    uint8_t high;   /* frames that STEP stays high */
    uint8_t rise_wait;
    uint8_t dir_wait;
    int32_t count;
    uint16_t *word;     /* where its levels go: port 0 or 1 of its slot */
    uint16_t step_mask; /* a motor's STEP and DIR are on one port */
    uint16_t dir_mask;
} motor_t;

typedef struct {
    uint16_t length;
    uint8_t flags;
    uint16_t hold_slope;
    uint16_t stop_slope;
    terms_t terms[MOTORS];
} segment_t;

typedef struct {
    motor_t motor[MOTORS];
    segment_t queue[QUEUE_SLOTS];
    uint8_t used, rest_points;
    uint16_t played;
    uint16_t last_slope;
    int32_t room;
    uint32_t motion_frame, real_frame;
    uint32_t rate, target; /* Q0.24 */
    uint32_t phase;
    segment_t *at;   /* the segment that plays */
    motor_t *next;   /* the motor whose turn it is */
    terms_t *terms;  /* and its terms */
    uint8_t moving, braking, play, first, notices;
    uint16_t word[2 * PERIODS];    /* on the pins in this frame, port 0 and port 1 of each period */
    uint16_t slot_word[2 * SLOTS]; /* being made for the next one */
    uint16_t line_word[2];
    uint8_t period;
    uint16_t raw, active, unsettled;
    uint16_t agree[DEBOUNCE_BITS]; /* one counter per input, bit by bit */
    int16_t hand_pending;
    uint32_t hand_phase;
    uint8_t hand_dir, hand_high, hand_rise_wait, hand_dir_wait;
} board_t;

extern board_t board;
extern const uint16_t entry_word[2 * PERIODS];

extern volatile uint16_t port_word[2]; /* stands for the ports: 4 bytes stored */
extern volatile uint16_t port_in;

static void tick(void);

#endif
