/* The tick of the board for an ATmega2560 at 16 MHz: one base period, 640 cycles.
 *
 * A frame is eight base periods. Each one puts out its port word and does its part of the frame's work:
 *
 *     period   0                 1                    2        3        4        5        6        7
 *     slot     0                 0                    1        1        2        2        3        3
 *     work     account, segment, brake?, play?        motor 0  motor 1  motor 2  motor 3  motor 4  hand, inputs,
 *              wanted rate       hand's pulse rate                                                 HEARTBEAT
 *
 * A port word is made when it goes out, from the table's entry and the levels of its slot. All motors must change in one frame, so the
 * levels of a slot may change only between the slot's last word of one frame and its first one of the next. Hence motors are kept in the order
 * of their slots: two of slot 0 and two of slot 1 behind periods 1 and 3, one of slot 2 behind period 5, the hand (slots 2 and 3) behind period 7.
 * HEARTBEAT changes in slot 0 behind period 7 and in the others before their first words. The script refuses a table and wiring
 * with which this order does not hold; such a configuration needs another order, or two sets of levels.
 *
 * Left out, and not measured: events, the start gate, status and lease timers, what inputs set off (triggers, ESTOP, OVERFLOW, buttons), the
 * settling after the queue has drained, the check for late steps, low water behind a point of rest, lines other than HEARTBEAT, the serial
 * interrupts. The main loop prepares segments (sign extension, slopes as rates) and keeps the upper halves of the frame counters.
 *
 * A motor keeps, instead of position and count, the count and the lag p + 1/2 - count: the lag is small, so its whole part needs
 * one byte, and the step rule becomes "whole part of lag is not 0". The sum of both is the position, bit for bit.
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
#define FIRST_MOTOR 2 /* its period */
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
    uint8_t whole;  /* .. and the whole part */
    uint8_t dir;    /* 0x80 = negative */
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
    __uint24 hold_step, stop_step; /* what the slopes change the rate by in a frame */
    terms_t terms[MOTORS];
} segment_t;

/* One entry of the select/strobe table. */
typedef struct {
    uint32_t word; /* both ports without the slot's levels */
    uint32_t *slot;
    motor_t *motor; /* what the period updates; 0: something else */
} entry_t;

/* Eight inputs. */
typedef struct {
    uint8_t raw, active, unsettled;
    uint8_t agree[DEBOUNCE_BITS]; /* one counter per input, bit by bit */
} inputs_t;

typedef struct {
    int16_t pending;
    __uint24 phase;
    uint8_t phase_one; /* phase is a whole pulse */
    uint8_t dir, high, rise_wait, dir_wait;
} hand_t;

typedef struct {
    motor_t motor[MOTORS];
    segment_t queue[QUEUE_SLOTS];
    uint8_t used, rest_points;
    uint16_t played;
    uint16_t last_slope;
    __uint24 room; /* u40: more than 32 segments can have */
    uint16_t room_high;
    uint16_t motion_frame, real_frame; /* lower halves; the main loop keeps the upper ones */
    uint32_t rate, target; /* Q0.24 */
    uint32_t wanted, lower; /* rates from one part of motion time to the next */
    uint32_t phase;
    segment_t *at;   /* the segment that plays */
    terms_t *terms;  /* of the motor whose turn it is */
    uint8_t moving, braking, play, first, notices;
    uint32_t slot[SLOTS]; /* levels of STEP, DIR and lines in each slot, both ports */
    uint8_t at_entry;     /* offset in the table */
    inputs_t inputs[2];
    hand_t hand;
} board_t;

extern board_t board;
extern const entry_t entry[PERIODS];

extern volatile uint32_t port_word; /* stands for the ports: 4 bytes stored */
extern volatile uint16_t port_in;

#endif
