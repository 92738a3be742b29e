/* Measures the tick in the simulator and prints what it did, for the script to compare with the reference.
 *
 * Timer 1's compare interrupt, every 640 cycles, is the tick; timer 3 counts cycles. The main program spins reading timer 3: the difference of the
 * readings before and behind a tick is the time that the tick took from it, prologue, epilogue and one turn of the spin included.
 */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <string.h>

#include "kernel.c"

#define BASE_PERIOD 640

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

/* FNV-1a over the words that a frame put out */
static uint32_t hash = 2166136261UL;

static void note_word(void)
{
    uint32_t word = port_word[0] | (uint32_t)port_word[1] << 16;
    uint8_t i;
    for (i = 0; i < 4; i++) {
        hash = (hash ^ (uint8_t)word) * 16777619UL;
        word >>= 8;
    }
}

#define PERIOD (*(volatile uint8_t *)&board.period)

static void run(uint32_t ticks)
{
    uint16_t now, before;
    while (ticks--) {
        uint8_t period = PERIOD;
        now = TCNT3;
        TIMSK1 = 1 << OCIE1A;
        do {
            before = now;
            now = TCNT3;
        } while (PERIOD == period);
        now = TCNT3 - before;
        TIMSK1 = 0; /* no tick while its word is noted */
        if (now > worst[period])
            worst[period] = now;
        total[period] += now;
        samples++;
        note_word();
    }
}

/* What the spin itself adds to a measurement: from one turn to two; the least is taken off. */
static uint16_t turn_of_the_spin(void)
{
    uint16_t now, before, least = 0xffff;
    uint8_t i;
    now = TCNT3;
    for (i = 0; i < 8; i++) {
        do {
            before = now;
            now = TCNT3;
        } while (PERIOD == 255);
        if (now - before < least)
            least = now - before;
    }
    return least;
}

static const segment_t program[] = {SEGMENTS};
static const uint8_t half[MOTORS] = {HALVES};
static const uint16_t masks[MOTORS][2] = {MASKS};

int main(void)
{
    uint8_t i;
    UCSR0B = 1 << TXEN0;
    memcpy(board.queue, program, sizeof program);
    board.used = sizeof program / sizeof program[0];
    board.rest_points = REST_POINTS;
    board.moving = 1;
    board.first = 1;
    board.last_slope = 0xffff;
    board.target = board.rate = 0x1000000UL;
    board.at = board.queue;
    for (i = 0; i < MOTORS; i++) {
        board.motor[i].lag[5] = 0x80; /* p = 0: lag = 1/2 */
        board.motor[i].word = &board.slot_word[half[i]];
        board.motor[i].step_mask = masks[i][0];
        board.motor[i].dir_mask = masks[i][1];
    }
    next_words();
    board.line_word[0] = 0; /* the first frame shows heartbeat 0 */
    for (i = 0; i < PERIODS; i++)
        board.word[2 * i] ^= 0x200;
    OCR1A = BASE_PERIOD - 1;
    TCCR1A = 0;
    TCCR1B = (1 << WGM12) | (1 << CS10);
    TCCR3B = 1 << CS30;
    sei();
    run(PERIODS);
    board.hand_pending = -40; /* the hand is a frame ahead of the motors */
    board.hand_phase = 0x1000000UL;
    run(PERIODS * (FRAMES_BEFORE_HOLD - 1));
    board.braking = 1;
    port_in = 0x2aa; /* several inputs change at once and bounce */
    run(PERIODS * 3UL);
    port_in = 0x3ff;
    run(PERIODS * FRAMES_HOLDING);
    board.braking = 0;
    board.moving = 1;
    run(PERIODS * FRAMES_AFTER_HOLD);
    cli();
    for (i = 0; i < MOTORS; i++)
        motor_frame(); /* the motion frame that the last frame decided to play */
    text("hash ");
    hex(hash, 8);
    text("\nframe ");
    hex(board.motion_frame, 8);
    text("\n");
    for (i = 0; i < MOTORS; i++) {
        text("motor ");
        hex((uint32_t)board.motor[i].count, 8);
        bytes(board.motor[i].lag, 7);
        bytes(board.at->terms[i].v, 6);
        text("\n");
    }
    text("spin ");
    hex(turn_of_the_spin(), 4);
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
