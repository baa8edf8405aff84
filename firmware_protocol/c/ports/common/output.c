/* The queue between the core and the DACs. The core computes the codes of an instant when its time has come, or
 * a little later where its interrupt is masked. The timer latches them a constant time after the instant, `lead`, so that
 * no lateness below that is to be seen at the outputs. */
#include "port.h"

#include <string.h>

typedef struct {
    uint64_t tick;
    int16_t codes[TA_CHANNELS];
    uint8_t lines; /* of the markers */
} instant;

static instant queue[PORT_QUEUE];
static volatile uint32_t queued;
static volatile uint32_t latched;
static uint8_t lines; /* of the instants that come; the interrupt of the instants alone uses it */

/* Variables of the interrupt of the latch alone. */
static bool loaded;    /* the oldest of the queue is in the DACs */
static uint64_t due;   /* when it is to be latched */
static instant latest; /* what was latched last */
static uint64_t moved; /* when the outputs last changed */

void port_marks(void *context, uint8_t code)
{
    (void)context;
    lines = code;
}

void port_put_out(void *context, uint64_t tick, uint32_t position, const int16_t *codes)
{
    (void)context;
    (void)position;
    while (queued - latched == PORT_QUEUE) { /* the latch, which takes precedence, makes room */
    }
    instant *next = &queue[queued % PORT_QUEUE];
    next->tick = tick;
    memcpy(next->codes, codes, sizeof next->codes);
    next->lines = lines;
    __asm__ volatile("" ::: "memory"); /* complete before it is counted */
    queued++;
    port_pend(board.latch_irq);
}

/* Whether the outputs are to change; those of power-up are not known. */
static bool moves(const instant *next)
{
    return latched == 0 || memcmp(next->codes, latest.codes, sizeof next->codes) != 0;
}

/* An instant that comes later than `lead` is late at the outputs as well, and those that follow it too: closer to
 * each other than they were due they would exceed the slew limit in volts per second (7.1, 11.1). Where
 * nothing changes there is no such limit, so that the outputs are in time again once they are at rest. */
static void load(const instant *next)
{
    uint64_t apart = next->tick > latest.tick ? next->tick - latest.tick : 0;
    due = next->tick + board.lead;
    if (moves(next)) {
        due = due < moved + apart ? moved + apart : due;
        board_load(next->codes);
    }
}

/* Whether the time of what is loaded has come; if not, the timer interrupts then. */
static bool is_due(void)
{
    if (port_ticks() < due) {
        board_latch_at(due);
    }
    return port_ticks() >= due;
}

void port_latch(void)
{
    while (loaded || queued != latched) {
        const instant *next = &queue[latched % PORT_QUEUE];
        if (!loaded) {
            load(next);
            loaded = true;
        }
        if (!is_due()) {
            return;
        }
        board_latch();
        if (next->lines != latest.lines) {
            board_mark(next->lines);
        }
        moved = moves(next) ? port_ticks() : moved;
        latest = *next;
        loaded = false;
        latched++;
    }
}
