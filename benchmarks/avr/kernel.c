/* See kernel.h. A line by line port of the tick path of rm501_firmware_model. */
#include <string.h>

#include "kernel.h"

#define RATE_ONE 0x1000000UL
#define STEP_LENGTH 1
#define RISE_WAIT 2
#define DIR_WAIT 1
#define SETUP 1
#define ROOM_FULL (1L << 19)
#define FLAG_REST 2
#define NOTICE_LOW_WATER 1
#define NOTICE_RATE_ZERO 2
#define NOTICE_DRAINED 4
#define NOTICE_UNDERRUN 8
#define HAND_INCREMENT 6710886UL /* 1250 Hz in pulses per frame, Q0.24 */
#define HEARTBEAT 0x200

board_t board;
volatile uint16_t port_word[2];
volatile uint16_t port_in;

/* port words of the RM-501's table, all outputs inverted; STEP/DIR bits of each motor; see BoardLayout */
const uint16_t entry_word[2 * PERIODS] = {ENTRY_WORDS};
/* frames of equal samples, bit by bit: 2 for inputs 0, 3 and 7, 8 for the others */
static const uint16_t debounce[DEBOUNCE_BITS] = {0, 0x089, 0, 0x376};

static void turn(motor_t *m)
{
    m->dir ^= 1;
    *m->word ^= m->dir_mask;
    if (m->rise_wait < SETUP)
        m->rise_wait = SETUP;
}

/* lag += v; v += a; a += j: sums of 7, 6 and 5 bytes. Loads and stores leave the carry alone; the compiler's 64-bit sums take
 * three times as long. Offsets in terms_t: v 0, a 6, j 11. */
#define SUM_LAG(i, op, r) "ldd r25, %a0+" #i "\n\t" #op " r25, " #r "\n\tstd %a0+" #i ", r25\n\t"
#define SUM_V(i, op, r) "ldd r25, %a1+6+" #i "\n\t" #op " " #r ", r25\n\tstd %a1+" #i ", " #r "\n\t"
#define SUM_A(i, op) "ldd r18, %a1+6+" #i "\n\tldd r19, %a1+11+" #i "\n\t" #op " r18, r19\n\tstd %a1+6+" #i ", r18\n\t"

static inline void differences(motor_t *m, terms_t *t)
{
    __asm__ volatile("ldd r18, %a1+0\n\t"
                     "ldd r19, %a1+1\n\t"
                     "ldd r20, %a1+2\n\t"
                     "ldd r21, %a1+3\n\t"
                     "ldd r22, %a1+4\n\t"
                     "ldd r23, %a1+5\n\t"
                     "mov r24, r23\n\t"
                     "lsl r24\n\t"
                     "sbc r24, r24\n\t" /* 0xff when v is negative */
                     SUM_LAG(0, add, r18) SUM_LAG(1, adc, r19) SUM_LAG(2, adc, r20) SUM_LAG(3, adc, r21)
                     SUM_LAG(4, adc, r22) SUM_LAG(5, adc, r23) SUM_LAG(6, adc, r24)
                     "ldd r24, %a1+10\n\t"
                     "lsl r24\n\t"
                     "sbc r24, r24\n\t" /* 0xff when a is negative */
                     SUM_V(0, add, r18) SUM_V(1, adc, r19) SUM_V(2, adc, r20) SUM_V(3, adc, r21)
                     SUM_V(4, adc, r22)
                     "adc r23, r24\n\t"
                     "std %a1+5, r23\n\t"
#if CUBIC
                     "ldd r24, %a1+14\n\t"
                     "lsl r24\n\t"
                     "sbc r24, r24\n\t" /* 0xff when j is negative */
                     SUM_A(0, add) SUM_A(1, adc) SUM_A(2, adc) SUM_A(3, adc)
                     "ldd r18, %a1+10\n\t"
                     "adc r18, r24\n\t"
                     "std %a1+10, r18\n\t"
#endif
                     :
                     : "b"(m), "b"(t)
                     : "r18", "r19", "r20", "r21", "r22", "r23", "r24", "r25", "memory");
}

static uint8_t is_zero(const uint8_t *v)
{
    return (v[0] | v[1] | v[2] | v[3] | v[4] | v[5]) == 0;
}

static void __attribute__((noinline)) motor_frame(void)
{
    motor_t *m = board.next;
    terms_t *t = board.terms;
    int8_t whole;
    if (!board.play)
        return;
    differences(m, t);
    board.next = m + 1;
    board.terms = t + 1;
    if (m->high && --m->high == 0)
        *m->word ^= m->step_mask;
    if (m->rise_wait)
        m->rise_wait--;
    if (m->dir_wait)
        m->dir_wait--;
    whole = m->whole;
    if (whole) {
        if ((whole < 0) == m->dir) {
            if (m->rise_wait == 0) {
                if (m->dir) {
                    m->count--;
                    m->whole = whole + 1;
                } else {
                    m->count++;
                    m->whole = whole - 1;
                }
                m->high = STEP_LENGTH;
                m->rise_wait = RISE_WAIT;
                m->dir_wait = DIR_WAIT;
                *m->word ^= m->step_mask;
            }
        } else if (m->dir_wait == 0) {
            turn(m);
        }
    } else if (m->dir_wait == 0) {
        uint8_t negative = t->v[5] >> 7;
        if (negative != m->dir && (negative || !is_zero(t->v)))
            turn(m);
    }
}

/* Small functions that share nothing but `board`: what one of them keeps in registers, the others need not save. */

static uint8_t __attribute__((noinline)) must_brake(uint32_t rate)
{
    int32_t room;
    uint16_t rate15;
    if (board.rest_points)
        return 0;
    room = board.room - 2L * board.at->hold_slope;
    if (room > ROOM_FULL)
        return 0;
    if (room <= 0)
        return 1;
    rate15 = (uint16_t)(((rate + 511) >> 8) >> 1);
    return (uint32_t)rate15 * rate15 >= ((uint32_t)room << 8) << 3;
}

/* The last frame of the segment at the head was played a frame ago; 0 when the queue is empty. */
static uint8_t __attribute__((noinline)) next_segment(void)
{
    segment_t *s = board.at;
    board.last_slope = s->hold_slope;
    if (s->flags & FLAG_REST)
        board.rest_points--;
    board.played = 0;
    board.first = 1;
    board.at = s == &board.queue[QUEUE_SLOTS - 1] ? board.queue : s + 1;
    if (--board.used)
        return 1;
    board.rate = 0;
    board.moving = 0;
    board.notices |= s->flags & FLAG_REST ? NOTICE_DRAINED : NOTICE_UNDERRUN;
    return 0;
}

static void __attribute__((noinline)) slow_down(uint16_t slope)
{
    uint32_t step = (uint32_t)slope << 4;
    board.rate = board.rate > step ? board.rate - step : 0;
}

/* Change the rate by at most the slope: up to the target, or down to it, or to 0. */
static void __attribute__((noinline)) ramp(void)
{
    uint32_t step, wanted;
    if (board.braking) {
        slow_down(board.braking == 2 ? board.at->stop_slope : board.at->hold_slope);
        return;
    }
    step = (uint32_t)board.at->hold_slope << 4;
    wanted = board.target;
    if (board.rate < wanted) {
        if (board.rate + step < wanted)
            wanted = board.rate + step;
    } else if (board.rate > wanted + step) {
        wanted = board.rate - step;
    }
    if (must_brake(wanted)) {
        board.braking = 1;
        board.notices |= NOTICE_LOW_WATER;
        slow_down(board.at->hold_slope);
        return;
    }
    board.rate = wanted;
}

/* One frame of motion time: whether a motion frame is played, and the account of the queue. */
static void __attribute__((noinline)) motion_time(void)
{
    segment_t *s;
    uint16_t slope;
    board.play = 0;
    if (!board.moving)
        return;
    if (board.played == board.at->length && !next_segment())
        return;
    if (board.braking || board.rate != board.target || (!board.rest_points && must_brake(board.rate)))
        ramp();
    if (board.rate == 0) {
        board.moving = 0;
        board.notices |= NOTICE_RATE_ZERO;
        return;
    }
    board.phase += board.rate;
    if (board.phase < RATE_ONE)
        return;
    board.phase -= RATE_ONE;
    s = board.at;
    slope = s->hold_slope;
    if (board.first) {
        board.first = 0;
        if (board.last_slope < slope)
            slope = board.last_slope;
    }
    board.room -= slope;
    board.played++;
    board.motion_frame++;
    board.play = 1;
    board.next = board.motor;
    board.terms = s->terms;
}

/* Debounce all inputs at once: their counters of equal samples lie bit by bit in words, so one addition counts them all. */
static void __attribute__((noinline)) sample_inputs(void)
{
    uint16_t pins = port_in, flipped = board.raw ^ pins, unsettled, carry, differs = 0;
    uint8_t bit;
    if (board.unsettled == 0 && flipped == 0)
        return;
    board.raw = pins;
    unsettled = board.unsettled | (pins ^ board.active);
    carry = unsettled;
    for (bit = 0; bit < DEBOUNCE_BITS; bit++) {
        uint16_t plane = board.agree[bit] & ~flipped; /* a sample that differs from the one before starts again */
        uint16_t sum = plane ^ carry;
        carry &= plane;
        board.agree[bit] = sum;
        differs |= sum ^ debounce[bit];
    }
    carry = unsettled & ~differs; /* settled in this frame */
    board.unsettled = unsettled & ~carry;
    board.active ^= (pins ^ board.active) & carry;
}

static void __attribute__((noinline)) hand_frame(void)
{
    if (board.hand_high && --board.hand_high == 0)
        board.slot_word[2 * 3] ^= HAND_MASK;
    if (board.hand_rise_wait)
        board.hand_rise_wait--;
    if (board.hand_dir_wait)
        board.hand_dir_wait--;
    if (board.hand_pending == 0)
        return;
    if (board.hand_phase < RATE_ONE)
        board.hand_phase += HAND_INCREMENT;
    if ((board.hand_pending < 0) != board.hand_dir) {
        if (board.hand_dir_wait == 0) {
            board.hand_dir ^= 1;
            board.slot_word[2 * 2] ^= HAND_MASK;
            board.hand_rise_wait = SETUP;
        }
    } else if (board.hand_rise_wait == 0 && board.hand_phase >= RATE_ONE) {
        board.hand_phase -= RATE_ONE;
        board.slot_word[2 * 3] ^= HAND_MASK;
        board.hand_high = STEP_LENGTH;
        board.hand_rise_wait = RISE_WAIT;
        board.hand_dir_wait = DIR_WAIT;
        board.hand_pending += board.hand_pending > 0 ? -1 : 1;
    }
}

#define SLOT(n) \
    low = board.slot_word[2 * n] ^ board.line_word[0]; \
    high = board.slot_word[2 * n + 1] ^ board.line_word[1]; \
    board.word[4 * n] = entry_word[4 * n] ^ low; \
    board.word[4 * n + 1] = entry_word[4 * n + 1] ^ high; \
    board.word[4 * n + 2] = entry_word[4 * n + 2] ^ low; \
    board.word[4 * n + 3] = entry_word[4 * n + 3] ^ high

static void __attribute__((noinline)) next_words(void)
{
    uint16_t low, high;
    board.line_word[0] ^= HEARTBEAT;
    SLOT(0);
    SLOT(1);
    SLOT(2);
    SLOT(3);
    board.real_frame++;
}

static void __attribute__((noinline)) tick(void)
{
    uint8_t period = board.period;
    const uint16_t *word = &board.word[2 * period];
    port_word[0] = word[0];
    port_word[1] = word[1];
    board.period = (period + 1) & (PERIODS - 1);
    if (period < MOTORS) {
        motor_frame();
    } else if (period == 5) {
        motion_time();
    } else if (period == 6) {
        sample_inputs();
        hand_frame();
    } else {
        next_words();
    }
}
