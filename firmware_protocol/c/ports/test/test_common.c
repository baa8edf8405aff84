/* Test of what the ports share, on a computer: a board whose time the test moves on. Prints what is wrong. */
#define _GNU_SOURCE
#include "port.h"

#include <stdio.h>
#include <string.h>
#include <sys/mman.h>

#define PERIOD 100u
#define LEAD 400u

const port_board board = {.counter_mask = UINT32_MAX, .lead = LEAD};

static uint64_t now;
static uint64_t alarm = UINT64_MAX;
static int16_t in_dac;
static int failures;

/* What was latched, and when. */
static struct {
    uint64_t tick;
    int16_t code;
} latches[1000];
static size_t count;

/* Changes of the marker lines, and when. */
static struct {
    uint64_t tick;
    uint8_t lines;
} marks[10];
static size_t marked;

static void check(bool good, const char *what)
{
    if (!good) {
        printf("%s\n", what);
        failures++;
    }
}

uint64_t port_ticks(void)
{
    return now;
}

void board_latch_at(uint64_t tick)
{
    alarm = tick;
}

void board_load(const int16_t *codes)
{
    in_dac = codes[0];
}

void board_latch(void)
{
    latches[count].tick = now;
    latches[count++].code = in_dac;
}

void board_mark(uint8_t lines)
{
    check(count > 0 && latches[count - 1u].tick == now, "after the latch of the same tick");
    marks[marked].tick = now;
    marks[marked++].lines = lines;
}

/* Lets the time pass, and the timer interrupt. */
static void pass_until(uint64_t tick)
{
    while (alarm <= tick) {
        now = alarm;
        alarm = UINT64_MAX;
        port_latch();
    }
    now = tick;
}

static void put_out(uint64_t tick, int16_t code)
{
    int16_t codes[TA_CHANNELS] = {0};
    codes[0] = code;
    port_put_out(NULL, tick, 0, codes);
    port_latch(); /* it has been pended */
}

/* Puts out `more` instants from *tick on, each in time, with codes that rise by `step`. */
static void put_out_in_time(uint64_t *tick, int16_t *code, unsigned more, int16_t step)
{
    while (more-- > 0) {
        *tick += PERIOD;
        *code = (int16_t)(*code + step);
        pass_until(*tick);
        put_out(*tick, *code);
    }
}

static void test_each_code_is_latched_at_its_time(uint64_t *tick, int16_t *code)
{
    uint64_t first = *tick + PERIOD + LEAD;
    put_out_in_time(tick, code, 20, 1);
    pass_until(*tick + LEAD);
    check(count == 20, "each instant is latched once");
    for (size_t i = 0; i < count; i++) {
        check(latches[i].tick == first + i * PERIOD, "at its time");
        check(latches[i].code == (int16_t)(i + 1u), "with its code");
    }
    *tick = now;
}

static void test_late_codes_are_a_period_apart(uint64_t *tick, int16_t *code)
{
    count = 0;
    pass_until(*tick + 12u * PERIOD);
    for (unsigned i = 0; i < 12; i++) {
        *tick += PERIOD;
        *code = (int16_t)(*code + 1);
        put_out(*tick, *code);
    }
    put_out_in_time(tick, code, 20, 1);
    pass_until(*tick + 2u * LEAD + 12u * PERIOD);
    check(count == 32, "each instant is latched once, also late");
    for (size_t i = 1; i < count; i++) {
        check(latches[i].tick - latches[i - 1u].tick >= PERIOD, "a period after the one before");
        check(latches[i].code == latches[i - 1u].code + 1, "in order");
    }
}

static void test_outputs_at_rest_are_in_time_again(uint64_t *tick, int16_t *code)
{
    *tick = now;
    put_out_in_time(tick, code, 20, 0);
    count = 0;
    pass_until(*tick + LEAD);
    count = 0;
    *tick = now;
    put_out_in_time(tick, code, 1, 1);
    pass_until(*tick + LEAD);
    check(count == 1 && latches[0].tick == *tick + LEAD, "in time after a rest");
}

/* The fourth of ten instants has a mark of two instants, while others wait for their latch. */
static void test_marker_lines_change_at_their_latch(uint64_t *tick, int16_t *code)
{
    *tick = now;
    put_out_in_time(tick, code, 3, 1);
    port_marks(NULL, 5);
    put_out_in_time(tick, code, 2, 1);
    uint64_t shown = *tick - PERIOD + LEAD;
    port_marks(NULL, 0);
    put_out_in_time(tick, code, 5, 0);
    check(marked > 0 && marks[0].tick == shown, "no sooner than their latch");
    pass_until(*tick + LEAD);
    check(marked == 2 && marks[0].lines == 5 && marks[1].lines == 0, "changes, and nothing else");
    check(marks[1].tick == shown + 2u * PERIOD, "as long as the mark is");
}

static void test_delimiter_has_its_tick(void)
{
    static const uint8_t sent[] = {3, 1, 2, 0, 0, 7};
    uint8_t bytes[8];
    uint64_t tick;
    for (size_t i = 0; i < sizeof sent; i++) {
        now = UINT64_C(0x123456789A0) + i;
        port_received(sent[i]);
    }
    uint64_t first = now - 2u;
    now += 1000;
    check(port_take(bytes, 2, &tick) == 2 && bytes[1] == 1, "a part of a frame");
    check(port_take(bytes, 8, &tick) == 2 && tick == first, "ends at its delimiter, and has its tick");
    check(port_take(bytes, 8, &tick) == 1 && tick == first + 1u, "the next delimiter has its own");
    check(port_take(bytes, 8, &tick) == 1 && bytes[0] == 7 && tick == now, "the rest has the present one");
    check(port_take(bytes, 8, &tick) == 0, "then there is nothing");
}

static void test_full_ring_loses_what_comes_and_goes_on(void)
{
    uint8_t bytes[PORT_RX];
    uint64_t tick;
    for (unsigned i = 0; i < PORT_RX + 100u; i++) {
        port_received(1);
    }
    port_received(0);
    check(port_take(bytes, sizeof bytes, &tick) == PORT_RX, "as much as there is room");
    port_received(0);
    check(port_take(bytes, sizeof bytes, &tick) == 1 && bytes[0] == 0, "the next frame is whole");
}

static void test_what_is_sent_is_sent_whole_or_not(void)
{
    uint8_t bytes[PORT_TX];
    memset(bytes, 5, sizeof bytes);
    check(port_write(NULL, bytes, sizeof bytes - 1u), "there is room");
    check(!port_write(NULL, bytes, 2), "there is none");
    for (unsigned i = 0; i < sizeof bytes - 1u; i++) {
        check(port_next_byte() == 5, "each byte");
    }
    check(port_next_byte() == -1, "and no more");
}

int main(void)
{
    uint64_t tick = 0;
    int16_t code = 0;
    void *nvic = mmap((void *)0xE000E000, 4096, PROT_READ | PROT_WRITE,
                      MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED, -1, 0);
    check(nvic != MAP_FAILED, "memory in place of the NVIC");
    test_each_code_is_latched_at_its_time(&tick, &code);
    test_late_codes_are_a_period_apart(&tick, &code);
    test_outputs_at_rest_are_in_time_again(&tick, &code);
    test_marker_lines_change_at_their_latch(&tick, &code);
    test_delimiter_has_its_tick();
    test_full_ring_loses_what_comes_and_goes_on();
    test_what_is_sent_is_sent_whole_or_not();
    return failures == 0 ? 0 : 1;
}
