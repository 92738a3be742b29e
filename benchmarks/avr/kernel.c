/* See kernel.h. A line by line port of the tick path of rm501_firmware_model. */
#include "kernel.h"

#define RATE_ONE 0x1000000UL
#define STEP_LENGTH 1
#define RISE_WAIT 2
#define DIR_WAIT 1
#define SETUP 1
#define ROOM_FULL (1UL << 19)
#define FLAG_REST 2
#define NOTICE_LOW_WATER 1
#define NOTICE_RATE_ZERO 2
#define NOTICE_DRAINED 4
#define NOTICE_UNDERRUN 8
#define NEGATIVE 0x80
#define HAND_INCREMENT ((__uint24)6710886) /* 1250 Hz in pulses per frame, Q0.24 */

board_t board;
volatile uint32_t port_word;
volatile uint16_t port_in;

/* the RM-501's table, all outputs inverted; see BoardLayout */
const entry_t entry[PERIODS] = {ENTRIES};
/* frames of equal samples, bit by bit: 2 for inputs 0, 3 and 7, 8 for the others */
static const uint8_t debounce_low[DEBOUNCE_BITS] = {0, 0x89, 0, 0x76}, debounce_high[DEBOUNCE_BITS] = {0, 0, 0, 0x03};

/* Invert the levels of `mask` in a slot; only the bytes that have any are touched. */
#define INVERT_BYTE(n, i, mask) \
    if ((mask) >> 8 * (i) & 0xff) \
    ((uint8_t *)&board.slot[n])[i] ^= (uint8_t)((mask) >> 8 * (i))
#define INVERT(n, mask) \
    do { \
        INVERT_BYTE(n, 0, (uint32_t)(mask)); \
        INVERT_BYTE(n, 1, (uint32_t)(mask)); \
        INVERT_BYTE(n, 2, (uint32_t)(mask)); \
        INVERT_BYTE(n, 3, (uint32_t)(mask)); \
    } while (0)

/* lag += v; v += a; a += j: sums of 7, 6 and 5 bytes, every byte of the terms loaded once. Loads, stores, sbrc and dec leave the carry alone;
 * the compiler's 64-bit sums take three times as long. Offsets in terms_t: v 0, a 6, j 11. */
#define SUM_LAG(i, op, r) "ldd r25, %a0+" #i "\n\t" #op " r25, " #r "\n\tstd %a0+" #i ", r25\n\t"
#define SUM_V(i, op, r, a) #op " " #r ", " #a "\n\tstd %a1+" #i ", " #r "\n\t"
#define SUM_A(i, op, a) "ldd r18, %a1+11+" #i "\n\t" #op " " #a ", r18\n\tstd %a1+6+" #i ", " #a "\n\t"

static inline __attribute__((always_inline)) void differences(motor_t *m, terms_t *t)
{
    __asm__ volatile("ldd r18, %a1+0\n\t"
                     "ldd r19, %a1+1\n\t"
                     "ldd r20, %a1+2\n\t"
                     "ldd r21, %a1+3\n\t"
                     "ldd r22, %a1+4\n\t"
                     "ldd r23, %a1+5\n\t"
                     SUM_LAG(0, add, r18) SUM_LAG(1, adc, r19) SUM_LAG(2, adc, r20) SUM_LAG(3, adc, r21)
                     SUM_LAG(4, adc, r22) SUM_LAG(5, adc, r23)
                     "ldd r25, %a0+6\n\t"
                     "adc r25, r1\n\t"
                     "sbrc r23, 7\n\t" /* v is negative: its next byte is 0xff */
                     "dec r25\n\t"
                     "std %a0+6, r25\n\t"
                     "ldd r24, %a1+6\n\t"
                     "ldd r25, %a1+7\n\t"
                     "ldd r26, %a1+8\n\t"
                     "ldd r27, %a1+9\n\t"
                     "ldd r0, %a1+10\n\t"
                     SUM_V(0, add, r18, r24) SUM_V(1, adc, r19, r25) SUM_V(2, adc, r20, r26)
                     SUM_V(3, adc, r21, r27) SUM_V(4, adc, r22, r0)
                     "adc r23, r1\n\t"
                     "sbrc r0, 7\n\t"
                     "dec r23\n\t"
                     "std %a1+5, r23\n\t"
#if CUBIC
                     SUM_A(0, add, r24) SUM_A(1, adc, r25) SUM_A(2, adc, r26) SUM_A(3, adc, r27)
                     "adc r0, r1\n\t"
                     "sbrc r18, 7\n\t"
                     "dec r0\n\t"
                     "std %a1+10, r0\n\t"
#endif
                     :
                     : "b"(m), "b"(t)
                     : "r18", "r19", "r20", "r21", "r22", "r23", "r24", "r25", "r26", "r27", "memory");
}

static inline __attribute__((always_inline)) uint8_t is_zero(const uint8_t *v)
{
    return (v[0] | v[1] | v[2] | v[3] | v[4] | v[5]) == 0;
}

static void __attribute__((noinline)) motor_frame(motor_t *m)
{
    terms_t *t;
    uint8_t whole, toggled = 0;
    uint16_t toggle = 0;
    if (!board.play)
        return;
    t = board.terms;
    board.terms = t + 1;
    differences(m, t);
    whole = m->whole;
    if (m->high && --m->high == 0) {
        toggle = m->step_mask;
        toggled = 1;
    }
    if (m->rise_wait)
        m->rise_wait--;
    if (m->dir_wait)
        m->dir_wait--;
    if (whole) {
        if (((whole ^ m->dir) & NEGATIVE) == 0) {
            if (m->rise_wait == 0) {
                if (whole & NEGATIVE) {
                    m->count--;
                    m->whole = whole + 1;
                } else {
                    m->count++;
                    m->whole = whole - 1;
                }
                m->high = STEP_LENGTH;
                m->rise_wait = RISE_WAIT;
                m->dir_wait = DIR_WAIT;
                toggle ^= m->step_mask;
                toggled = 1;
            }
            goto levels;
        }
        if (m->dir_wait)
            goto levels;
    } else {
        uint8_t sign = t->v[5];
        if (m->dir_wait || !((sign ^ m->dir) & NEGATIVE) || (!(sign & NEGATIVE) && is_zero(t->v)))
            goto levels;
    }
    m->dir ^= NEGATIVE;
    if (m->rise_wait < SETUP)
        m->rise_wait = SETUP;
    toggle ^= m->dir_mask;
    toggled = 1;
levels:
    if (toggled)
        *m->word ^= toggle;
}

/* The last frame of the segment at the head was played a frame ago; 0 when the queue is empty. */
static inline __attribute__((always_inline)) uint8_t next_segment(void)
{
    segment_t *s = board.at;
    uint8_t at_rest = s->flags & FLAG_REST;
    board.last_slope = s->hold_slope;
    if (at_rest)
        board.rest_points--;
    board.played = 0;
    board.first = 1;
    board.at = s == &board.queue[QUEUE_SLOTS - 1] ? board.queue : s + 1;
    if (--board.used)
        return 1;
    board.rate = 0;
    board.moving = 0;
    board.notices |= at_rest ? NOTICE_DRAINED : NOTICE_UNDERRUN;
    return 0;
}

/* Motion time, first part: the rate that is wanted, at most a slope away from the present one, and the one that braking gives. */
static inline __attribute__((always_inline)) void wanted_rate(void)
{
    uint32_t step, rate, wanted, lower;
    if (!board.moving)
        return;
    if (board.played == board.at->length && !next_segment())
        return;
    step = board.braking == 2 ? board.at->stop_step : board.at->hold_step;
    rate = board.rate;
    lower = rate > step ? rate - step : 0;
    board.lower = lower;
    if (board.braking) {
        board.wanted = lower;
        return;
    }
    wanted = board.target;
    if (rate < wanted) {
        rate += step;
        if (rate < wanted)
            wanted = rate;
    } else if (lower > wanted) {
        wanted = lower;
    }
    board.wanted = wanted;
}

/* An empty asm keeps the compiler from joining two shifts and making them a loop. */
#define APART(n) __asm__("" : "+r"(n))

/* Whether motion at `rate` has to brake now in order not to outrun the queue: rate15^2 >= room 2^11, here without the lower 8 bits of
 * both sides, which are 0 on the right. */
static uint8_t __attribute__((noinline)) must_brake(void)
{
    __uint24 room, slopes;
    uint16_t rounded, middle;
    uint8_t high, low;
    if (board.rest_points || board.room_high)
        return 0;
    room = board.room;
    slopes = (__uint24)2 * board.at->hold_slope;
    if (room <= slopes)
        return 1;
    room -= slopes;
    if (room > ROOM_FULL)
        return 0;
    room += room;
    APART(room);
    room += room;
    APART(room);
    room += room;
    if (board.wanted >> 24)
        return 1; /* from rate 1 the full room is not enough */
    slopes = (__uint24)board.wanted + 511;
    if (slopes < 511)
        return 1;
    rounded = slopes >> 8;
    high = (uint8_t)(rounded >> 8) >> 1;
    low = rounded >> 1;
    APART(high); /* else the compiler multiplies 16 bits by 16 */
    APART(low);
    middle = (uint16_t)low * low;
    slopes = (uint8_t)(middle >> 8);
    middle = (uint16_t)high * low;
    slopes += middle;
    slopes += middle;
    middle = (uint16_t)high * high;
    slopes += (__uint24)middle << 8;
    return slopes >= room;
}

/* Motion time, second part: whether to brake for low water, and whether this frame plays a motion frame. */
static inline __attribute__((always_inline)) void decide_play(void)
{
    uint32_t rate, phase;
    if (!board.moving)
        return;
    if (!board.braking && must_brake()) {
        board.braking = 1;
        board.notices |= NOTICE_LOW_WATER;
        board.wanted = board.lower;
    }
    rate = board.wanted;
    board.rate = rate;
    if (rate == 0) {
        board.moving = 0;
        board.notices |= NOTICE_RATE_ZERO;
        return;
    }
    phase = board.phase + rate;
    if (phase >= RATE_ONE) {
        phase -= RATE_ONE;
        board.play = 1;
        board.motion_frame++;
        board.terms = board.at->terms;
    }
    board.phase = phase;
}

/* Motion time, third part: the account of the queue, if a motion frame was played. */
static inline __attribute__((always_inline)) void account(void)
{
    uint16_t slope;
    __uint24 room;
    if (!board.play)
        return;
    board.play = 0;
    slope = board.at->hold_slope;
    if (board.first) {
        board.first = 0;
        if (board.last_slope < slope)
            slope = board.last_slope;
    }
    room = board.room;
    if (room < slope)
        board.room_high--;
    board.room = room - slope;
    board.played++;
}

/* Debounce eight inputs at once: their counters of equal samples lie bit by bit in bytes, so one addition counts them all. */
static inline __attribute__((always_inline)) void debounce(inputs_t *in, uint8_t pins, const uint8_t *frames)
{
    uint8_t flipped = in->raw ^ pins, unsettled, carry, differs = 0, bit;
    if (in->unsettled == 0 && flipped == 0)
        return;
    in->raw = pins;
    unsettled = in->unsettled | (pins ^ in->active);
    carry = unsettled;
    for (bit = 0; bit < DEBOUNCE_BITS; bit++) {
        uint8_t plane = in->agree[bit] & ~flipped; /* a sample that differs from the one before starts again */
        uint8_t sum = plane ^ carry;
        carry &= plane;
        in->agree[bit] = sum;
        differs |= sum ^ frames[bit];
    }
    carry = unsettled & ~differs; /* settled in this frame */
    in->unsettled = unsettled & ~carry;
    in->active ^= (pins ^ in->active) & carry;
}

static inline __attribute__((always_inline)) void inputs(void)
{
    uint16_t pins = port_in;
    debounce(&board.inputs[0], (uint8_t)pins, debounce_low);
    debounce(&board.inputs[1], pins >> 8, debounce_high);
}

/* The hand's pulse rate; its levels are made in the last period. */
static inline __attribute__((always_inline)) void hand_phase(void)
{
    hand_t *h = &board.hand;
    __uint24 phase;
    if (h->phase_one || h->pending == 0)
        return;
    phase = h->phase + HAND_INCREMENT;
    if (phase < HAND_INCREMENT)
        h->phase_one = 1;
    h->phase = phase;
}

static inline __attribute__((always_inline)) void hand_frame(void)
{
    hand_t *h = &board.hand;
    int16_t pending;
    if (h->high && --h->high == 0)
        INVERT(HAND_PULSE_SLOT, HAND_MASK);
    if (h->rise_wait)
        h->rise_wait--;
    if (h->dir_wait)
        h->dir_wait--;
    pending = h->pending;
    if (pending == 0)
        return;
    if (((uint8_t)(pending >> 8) ^ h->dir) & NEGATIVE) {
        if (h->dir_wait == 0) {
            h->dir ^= NEGATIVE;
            INVERT(HAND_DIR_SLOT, HAND_MASK);
            if (h->rise_wait < SETUP)
                h->rise_wait = SETUP;
        }
    } else if (h->rise_wait == 0 && h->phase_one) {
        h->phase_one = 0;
        INVERT(HAND_PULSE_SLOT, HAND_MASK);
        h->high = STEP_LENGTH;
        h->rise_wait = RISE_WAIT;
        h->dir_wait = DIR_WAIT;
        h->pending = h->dir ? pending + 1 : pending - 1;
    }
}

/* All words of the frame are out: the line that changes every frame changes. It does so in the other slots before their first words. */
static inline __attribute__((always_inline)) void end_frame(void)
{
    INVERT(0, HEARTBEAT);
}

/* One function per period: what is called needs no more registers saved than it uses. */
static void __attribute__((noinline)) first_period(void)
{
    INVERT(2, HEARTBEAT);
    INVERT(3, HEARTBEAT);
    account();
    wanted_rate();
}

static void __attribute__((noinline)) second_period(void)
{
    INVERT(1, HEARTBEAT);
    board.real_frame++;
    hand_phase();
    decide_play();
}

static void __attribute__((noinline)) last_period(void)
{
    hand_frame();
    end_frame();
    inputs();
}

/* The word goes out first, always the same number of cycles behind the interrupt. */
static inline __attribute__((always_inline)) void tick(void)
{
    uint8_t at = board.at_entry;
    const entry_t *e = (const entry_t *)((const uint8_t *)entry + at);
    port_word = e->word ^ *e->slot;
    board.at_entry = (at + sizeof(entry_t)) & (PERIODS * sizeof(entry_t) - 1);
    if (e->motor) {
        motor_frame(e->motor);
    } else if (at == 0) {
        first_period();
    } else if (at == sizeof(entry_t)) {
        second_period();
    } else {
        last_period();
    }
}
