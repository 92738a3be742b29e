/* Measures the tick in the simulator and prints what it did, for the script to compare with the reference.
 *
 * The tick is timer 1's compare interrupt. It is called here instead of being waited for: a call takes the 5 cycles that the chip takes to
 * enter an interrupt, and the jump in the vector table, 3 cycles, is added. Timer 3 counts cycles, so the figure is exact.
 */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <string.h>

#include "kernel.c"

#define VECTOR_JUMP 3

/* the vector that the measurement calls: __vector_17 */
ISR(TIMER1_COMPA_vect)
{
    tick();
}

static void put(char c)
{
    while (!(UCSR0A & (1 << UDRE0)))
        ;
    UDR0 = c;
}

static void text(const char *s)
{
    while (*s)
        put(*s++);
}

static void hex(uint64_t value, uint8_t digits)
{
    while (digits--)
        put("0123456789abcdef"[(value >> (4 * digits)) & 15]);
    put(' ');
}

static void bytes(const uint8_t *at, uint8_t count)
{
    while (count--) {
        put("0123456789abcdef"[at[count] >> 4]);
        put("0123456789abcdef"[at[count] & 15]);
    }
    put(' ');
}

static uint16_t worst[PERIODS];
static uint32_t total[PERIODS];
static uint32_t samples;
static uint32_t motion_frame;

/* FNV-1a over the words that a frame put out */
static uint32_t hash = 2166136261UL;

static void note_word(void)
{
    uint32_t word = port_word;
    uint8_t i;
    for (i = 0; i < 4; i++) {
        hash = (hash ^ (uint8_t)word) * 16777619UL;
        word >>= 8;
    }
}

/* Cycles between two readings of the timer around `call`. */
#define CYCLES(call, result) \
    do { \
        uint16_t before_, after_; \
        __asm__ volatile("lds %A0, %2\n\tlds %B0, %2+1\n\t" call "\n\tlds %A1, %2\n\tlds %B1, %2+1" \
                         : "=&r"(before_), "=&r"(after_) \
                         : "n"(_SFR_MEM_ADDR(TCNT3)) \
                         : "memory"); \
        result = after_ - before_; \
    } while (0)

static void run(uint32_t ticks)
{
    uint16_t nothing, cycles;
    static uint16_t noise = 1;
    while (ticks--) {
        uint8_t period = board.at_entry / sizeof(entry_t);
        noise = noise >> 1 ^ (noise & 1 ? 0xb400 : 0); /* inputs bounce, rest long enough to settle, and bounce again */
        if (period == 0 && noise & board.real_frame & 0x10)
            port_in = noise & 0x3ff;
        CYCLES("", nothing);
        CYCLES("call __vector_17", cycles);
        cli(); /* reti has set the flag */
        cycles += VECTOR_JUMP - nothing;
        if (cycles > worst[period])
            worst[period] = cycles;
        total[period] += cycles;
        samples++;
        motion_frame += (uint16_t)(board.motion_frame - (uint16_t)motion_frame);
        note_word();
    }
}

static const segment_t program[] = {SEGMENTS};
static const uint8_t half[MOTORS] = {HALVES};
static const uint16_t masks[MOTORS][2] = {MASKS};

int main(void)
{
    uint8_t i;
    const segment_t *last;
    UCSR0B = 1 << TXEN0;
    memcpy(board.queue, program, sizeof program);
    board.used = sizeof program / sizeof program[0];
    board.rest_points = REST_POINTS;
    board.room = (ROOM) & 0xffffff;
    board.room_high = (ROOM) >> 24;
    board.slot[1] = board.slot[2] = board.slot[3] = HEARTBEAT; /* inverted again before it is shown */
    board.moving = 1;
    board.first = 1;
    board.last_slope = 0xffff;
    board.target = board.rate = 0x1000000UL;
    board.at = board.queue;
    for (i = 0; i < MOTORS; i++) {
        board.motor[i].lag[5] = 0x80; /* p = 0: lag = 1/2 */
        board.motor[i].word = (uint16_t *)board.slot + half[i];
        board.motor[i].step_mask = masks[i][0];
        board.motor[i].dir_mask = masks[i][1];
    }
    board.hand.pending = -1200;
    board.hand.phase_one = 1;
    TCCR3B = 1 << CS30;
    run(PERIODS * FRAMES_BEFORE_HOLD);
#if FRAMES_HOLDING
    board.braking = 1;
    board.hand.pending += 2000;
    run(PERIODS * FRAMES_HOLDING);
    board.braking = 0;
    board.moving = 1;
    run(PERIODS * FRAMES_AFTER_HOLD);
#endif
    account(); /* of the last frame */
    last = board.first ? board.at - 1 : board.at;
    text("hash ");
    hex(hash, 8);
    text("\nframe ");
    hex(motion_frame, 8);
    text("\n");
    for (i = 0; i < MOTORS; i++) {
        text("motor ");
        hex((uint32_t)board.motor[i].count, 8);
        bytes(board.motor[i].lag, 7);
        bytes(last->terms[i].v, 6);
        text("\n");
    }
    text("notices ");
    hex(board.notices, 2);
    text("\n");
    for (i = 0; i < PERIODS; i++) {
        text("period ");
        hex(worst[i], 4);
        hex(total[i], 8);
        hex(samples / PERIODS, 8);
        text("\n");
    }
    text("state ");
    hex(sizeof board, 4);
    hex(sizeof(motor_t), 4);
    hex(sizeof(segment_t), 4);
    text("\nend\n");
    while (!(UCSR0A & (1 << TXC0)))
        ;
    sleep_enable();
    sleep_cpu();
    return 0;
}
