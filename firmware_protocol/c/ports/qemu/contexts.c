/* Compares firmware of two contexts with firmware of one: an interrupt calls ta_run after random numbers of
 * instructions, anywhere in what handles packets and reports. It prints what does not hold, of these:
 *
 * - Each position is put out with the same codes.
 * - Each window of CORRELATION is what adding it up again gives, each STATUS has the time of its position, and a
 *   PULSE comes each millisecond.
 * - Guards that forbid all but what their channel does change places with such that allow everything: one that is
 *   half of either trips.
 * - An e-stop input that opens in the midst of a request stops whatever that request did.
 * - A START begins at its time and is told once, after whichever of its last instructions an instant comes; a GUARD
 *   leaves each entry whole.
 */
#include <string.h>

#include "../../test/board.h"
#include "bench.h"
#include "machine.h"

#define INSTANTS 1280u  /* length of a stream */
#define SEEDS 10u       /* streams with other interrupts */
#define STOPS 600u      /* requests in which the e-stop input opens */
#define SHORTEST 600u   /* instructions from the end of an interrupt to the next, at most: so many, and */
#define DOUBLED 5u      /* twice as many with each seed, up to 16 times */
#define MOST_UNSERVED 60u /* instants from one ta_serve to the next */
#define WINDOW_MS 10u
#define PULSE_MS 1u
#define FRAME 8u /* samples from frame to frame */

static int16_t expected[INSTANTS][TA_CHANNELS];
static const stream *playing;
static bool two_contexts;
static bool contact_open;
static uint32_t longest; /* instructions from the end of an interrupt to the next, at most */
static uint32_t windows;
static uint32_t pulse_due; /* credit of the next PULSE of the stream */
static volatile bool in_core;      /* the loop is where an instant may come */
static volatile uint32_t instants; /* that were put out since the stream began */
static volatile uint32_t served;   /* `instants` at the latest ta_serve */
static volatile uint32_t sent;     /* position up to which all has been handed over */
static volatile bool prepared;     /* enough has been, for the start */

static void fail(const char *what, uint32_t value)
{
    machine_print(playing->name);
    machine_print(two_contexts ? ", two contexts: " : ", one context: ");
    machine_print(what);
    machine_print(" ");
    machine_print_number(value);
    machine_print("\n");
    machine_exit(false);
}

/* Numerical Recipes' linear congruential generator. */
static uint32_t random_below(uint32_t limit)
{
    static uint32_t state = 1;
    state = state * 1664525u + 1013904223u;
    return (uint32_t)((uint64_t)limit * state >> 32);
}

/* The board */

/* The current of a channel: of even channels any, of odd ones none, as their guards demand. */
static int16_t current(uint32_t at, size_t channel)
{
    uint32_t any = (at * 31u + (uint32_t)channel) * 2654435761u >> 18;
    return channel % 2u == 0 ? (int16_t)(any - 8192u) : 0;
}

static void take_codes(void *context, uint64_t at, uint32_t of, const int16_t *codes)
{
    uint32_t n = of - position;
    (void)context;
    (void)at;
    instants++;
    if (amp.state != TP_STATE_RUNNING || amp.start_pending || n >= INSTANTS) {
        return;
    }
    if (!two_contexts) {
        memcpy(expected[n], codes, sizeof expected[n]);
    } else if (memcmp(expected[n], codes, sizeof expected[n]) != 0) {
        fail("other codes at the position", n);
    }
}

static void give_currents(void *context, int16_t *codes)
{
    (void)context;
    for (size_t c = 0; c < TA_CHANNELS; c++) {
        codes[c] = current(amp.player.position - position, c);
    }
}

/* Adds up the window again. */
static void check_window(const tp_correlation *m)
{
    uint32_t first = m->position - position;
    if (first + m->samples >= INSTANTS) {
        return;
    }
    static ta_correlator again;
    uint8_t entry[TA_ENTRY];
    int16_t currents[TA_CHANNELS];
    uint32_t begin = first > TA_CODES ? first - TA_CODES : 0;
    ta_correlator_start(&again, TA_CHANNELS, 0);
    for (uint32_t n = begin; n < first + m->samples && n < INSTANTS; n++) {
        ta_correlator_played(&again, expected[n]);
        for (size_t c = 0; c < TA_CHANNELS; c++) {
            currents[c] = current(n, c);
        }
        if (n >= first) {
            ta_correlator_open(&again, n, m->samples, m->range_ua);
            (void)ta_correlator_add(&again, currents);
        }
    }
    for (size_t i = 0; i < m->channels; i++) {
        ta_correlator_entry(&ta_correlator_window(&again)->sums[m->first_channel + i], entry);
        if (memcmp(entry, m->entries + TA_ENTRY * i, TA_ENTRY) != 0) {
            fail("another window at the position", first);
        }
    }
    windows++;
}

static void check_status(const tp_status *m)
{
    bool plays = m->state == TP_STATE_RUNNING && !amp.start_pending;
    if (plays && m->time - amp.start_tick != (uint64_t)PERIOD * (m->position - position)) {
        fail("another time of the position", m->position - position);
    }
}

static void check_pulse(const tp_pulse *m)
{
    uint32_t per_pulse = RATE * PULSE_MS / 1000u;
    uint32_t n = m->credit_position - TA_FIFO - position;
    if (m->state != TP_STATE_RUNNING || n == 0 || n > INSTANTS) {
        return;
    }
    if (pulse_due != 0 && m->credit_position != pulse_due) {
        fail("a PULSE that is missing before the position", n);
    }
    pulse_due = m->credit_position + per_pulse;
}

static bool check_packet(void *context, const uint8_t *bytes, size_t size)
{
    ta_packet p;
    tp_correlation correlation = {0};
    tp_status status = {0};
    tp_pulse pulse = {0};
    (void)context;
    in_core = false; /* checks take longer than a board has */
    if (!ta_packet_decode(&p, bytes, size)) {
        fail("a damaged packet of the size", (uint32_t)size);
    } else if (p.type == TP_CORRELATION && tp_correlation_decode(&correlation, p.payload, p.size)) {
        check_window(&correlation);
    } else if (p.type == TP_STATUS && tp_status_decode(&status, p.payload, p.size)) {
        check_status(&status);
    } else if (p.type == TP_PULSE && tp_pulse_decode(&pulse, p.payload, p.size)) {
        check_pulse(&pulse);
    } else if (p.type == TP_GUARDED) {
        fail("a guard that trips at the position", amp.player.position - position);
    }
    in_core = true;
    return true;
}

/* The interrupt */

/* Whether the next instant may come: not before what it is to play, nor long before reports are sent. */
static bool may_come(void)
{
    if (!in_core || instants - served > MOST_UNSERVED) {
        return false;
    }
    if (amp.start_pending) {
        return prepared || ta_next_instant(&amp) < amp.start_tick;
    }
    return amp.state != TP_STATE_RUNNING || ta_distance(sent, amp.player.position) > 1;
}

static void sample_interrupt(void)
{
    if (may_come()) {
        ta_run(&amp, ta_next_instant(&amp));
    }
    machine_interrupt_in(1u + random_below(longest), sample_interrupt);
}

static void mask(void *context)
{
    (void)context;
    machine_mask();
}

static void unmask(void *context)
{
    (void)context;
    machine_unmask();
}

/* The loop */

/* Even channels have a current, and may do all. Odd ones have none: their guards expect none either, and allow no
 * residual, or they expect any and allow all. Half of either makes a residual that is not allowed. */
static void guard_alternately(bool strict)
{
    static uint8_t entries[TA_CHANNELS][TA_GUARD_ENTRY];
    for (size_t c = 0; c < TA_CHANNELS; c++) {
        allow_all(entries[c]);
        if (c % 2u != 0) {
            memset(entries[c] + 4, strict ? 0 : 0xFF, 4);
            memset(entries[c] + 16, strict ? 0 : 0x20, 2u * TP_GUARD_TAPS);
        }
    }
    guard(entries);
}

void handle(const uint8_t *packet, size_t size)
{
    in_core = true;
    ta_receive(&amp, packet, size, amp.last_tick);
    ta_serve(&amp);
    in_core = false;
    served = instants;
}

static void prepare(void)
{
    pulse_due = 0;
    prepared = false;
    sent = position;
    begin(playing);
    set(TP_PARAMETER_PULSE_MS, PULSE_MS);
    if (playing->guarded) {
        set(TP_PARAMETER_CORRELATION_MS, WINDOW_MS);
    }
}

/* Plays a stream; the loop asks for STATUS whenever it has nothing to send. */
static void play(void)
{
    uint32_t next = first_packet(playing);
    uint32_t lead = 3u * playing->spacing;
    uint32_t beat = 0;
    bool strict = false;
    prepare();
    while (amp.player.position - position < INSTANTS) {
        if (instants / HEARTBEAT != beat) {
            beat = instants / HEARTBEAT;
            heartbeat();
        }
        if (ta_distance(next, amp.player.position) <= (int32_t)lead) {
            send_packet(playing, next);
            sent = is_spectrum(playing) ? next : next + BLOCK;
            next += playing->spacing;
        } else {
            prepared = true;
        }
        if (playing->guarded) {
            strict = !strict;
            guard_alternately(strict);
        }
        poll_status();
        if (!two_contexts) {
            ta_run(&amp, ta_next_instant(&amp));
        }
    }
    machine_interrupt_never();
    if (amp.player.phase != TP_PHASE_PLAYING) {
        fail("is in the phase", amp.player.phase);
    }
}

static bool quiet(const ta_counters *c)
{
    return c->late_samples + c->future_samples + c->lost_samples + c->underruns + c->limited_samples +
               c->dropped_replies + c->malformed + c->refused + c->trips + c->watchdogs + c->ignored ==
           0;
}

static void run(bool two)
{
    ta_hal hal = board_hal(&contact_open);
    hal.send = check_packet;
    hal.put_out = take_codes;
    hal.currents = playing->guarded ? give_currents : NULL;
    hal.mask = two ? mask : NULL;
    hal.unmask = two ? unmask : NULL;
    two_contexts = two;
    instants = 0;
    served = 0;
    if (!power_up(&hal)) {
        fail("does not power up", 0);
        return;
    }
    if (two) {
        machine_interrupt_in(longest, sample_interrupt);
    }
    play();
    if (!quiet(&amp.counters)) {
        fail("counts what did not come, until the position", amp.player.position - position);
    }
}

/* Requests of a board whose packets are counted, not checked */

static uint32_t pulses;

static bool count_pulses(void *context, const uint8_t *bytes, size_t size)
{
    (void)context;
    (void)size;
    pulses += bytes[0] == TP_PULSE ? 1u : 0u;
    return true;
}

static void power_up_in_two_contexts(bool guarded)
{
    ta_hal hal = board_hal(&contact_open);
    hal.send = count_pulses;
    hal.currents = guarded ? board_currents : NULL;
    hal.mask = mask;
    hal.unmask = unmask;
    two_contexts = true;
    if (!power_up(&hal)) {
        fail("does not power up", 0);
    }
}

/* E-stops */

static uint32_t opens_after; /* instants until the contact opens */

static void opening_interrupt(void)
{
    if (in_core) {
        contact_open = contact_open || --opens_after == 0;
        ta_run(&amp, ta_next_instant(&amp));
    }
    machine_interrupt_in(1u + random_below(longest), opening_interrupt);
}

/* A session is armed, started, stopped; the contact opens somewhere on the way. */
static void be_stopped(void)
{
    uint32_t before = amp.counters.trips;
    opens_after = 1u + random_below(40);
    machine_interrupt_in(1u + random_below(longest), opening_interrupt);
    while (amp.counters.trips == before) {
        begin(playing);
        stop();
    }
    machine_interrupt_never();
    if (amp.state != TP_STATE_ESTOP) {
        fail("plays on after an e-stop, in the state", amp.state);
    }
}

static void clear(void)
{
    contact_open = false;
    for (uint32_t i = 0; i < HEARTBEAT + 2u; i++) {
        ta_run(&amp, ta_next_instant(&amp));
    }
    clear_fault(amp.counters.trips);
    if (amp.state != TP_STATE_IDLE) {
        fail("is not cleared, but in the state", amp.state);
    }
}

static void run_stops(void)
{
    power_up_in_two_contexts(false);
    longest = SHORTEST;
    for (uint32_t i = 0; i < STOPS; i++) {
        be_stopped();
        clear();
    }
}

/* Requests in which one instant comes, at each of many places in turn */

#define ENDING 1500u /* instructions of a request, the last of them, among which the instant comes */
#define ENTRY_STEP 7u /* instructions from one instant to the next where a copy of an entry is to be met */

static void (*interrupted)(void);
static uint64_t requested_at; /* tick of the latest instant before the request */

static void instant_interrupt(void)
{
    ta_run(&amp, ta_next_instant(&amp));
}

static void request_with_instant_after(uint32_t instructions)
{
    pulses = 0;
    requested_at = amp.last_tick;
    machine_interrupt_in(instructions, instant_interrupt);
    interrupted();
    machine_interrupt_never();
}

static uint32_t instructions_of(void (*request)(void))
{
    uint32_t before = machine_instructions();
    request();
    return (machine_instructions() - before) & MACHINE_COUNT_MASK;
}

/* The stream waits for its time, and the change of state is told once. */
static void check_start(void)
{
    const ta_player *p = &amp.player;
    if (amp.state != TP_STATE_RUNNING || !amp.start_pending || p->position != position ||
        amp.start_tick != requested_at + (uint64_t)START_MS * TICK_HZ / 1000u) {
        fail("an instant within START begins it, in the state", amp.state);
    }
    if (pulses != 1u) {
        fail("an instant within START changes the number of PULSEs to", pulses);
    }
}

static void be_armed(void)
{
    heartbeat();
    stop();
    ta_run(&amp, ta_next_instant(&amp));
    ta_serve(&amp);
    amp.start_tick = 0; /* as before the first START */
    amp.pulse_tick = amp.last_tick; /* no PULSE is due */
}

static void sweep_start(void)
{
    begin(playing);
    be_armed();
    uint32_t all = instructions_of(start);
    interrupted = start;
    for (uint32_t after = all - ENDING; after <= all; after++) {
        be_armed();
        request_with_instant_after(after);
        check_start();
    }
}

static void guard_strictly(void)
{
    guard_alternately(true);
}

/* A block of the guards ends at the next instant, after which entries that wait are in force. */
static void be_at_the_end_of_a_block(void)
{
    heartbeat();
    guard_alternately(false);
    ta_serve(&amp);
    amp.guard.left = 1;
}

/* An entry is one of the two, and none is made of both. */
static void check_guards(void)
{
    for (size_t c = 1; c < TA_CHANNELS; c += 2u) {
        const ta_guard_entry *e = &amp.guard.guards[c].entry;
        bool strict = e->limit == 0;
        if ((e->drive[0] == 0) != strict || (e->drive[TP_GUARD_TAPS - 1u] == 0) != strict) {
            fail("an instant within GUARD takes half an entry of the channel", (uint32_t)c);
        }
    }
}

static void sweep_guards(void)
{
    begin(playing);
    while (amp.start_pending) {
        ta_run(&amp, ta_next_instant(&amp));
    }
    uint32_t all = instructions_of(guard_strictly);
    interrupted = guard_strictly;
    for (uint32_t after = 1; after <= all; after += ENTRY_STEP) {
        be_at_the_end_of_a_block();
        request_with_instant_after(after);
        check_guards();
    }
}

static void sweep(void)
{
    power_up_in_two_contexts(false);
    sweep_start();
    power_up_in_two_contexts(true);
    sweep_guards();
}

int main(void)
{
    static const stream streams[] = {
        {"pcm16", TP_SAMPLE_FORMAT_PCM16, BLOCK, false, false},
        {"spectrum", TP_SAMPLE_FORMAT_SPECTRUM8, FRAME, false, false},
        {"guarded", TP_SAMPLE_FORMAT_PCM16, BLOCK, false, true},
    };
    machine_begin();
    playing = &streams[0];
    sweep();
    for (size_t i = 0; i < sizeof streams / sizeof streams[0]; i++) {
        playing = &streams[i];
        position = 1000u * BLOCK;
        run(false);
        for (uint32_t seed = 0; seed < SEEDS; seed++) {
            longest = SHORTEST << seed % DOUBLED;
            run(true);
        }
        if (playing->guarded && windows < (SEEDS + 1u) * INSTANTS / 200u) {
            fail("too few windows", windows);
        }
    }
    run_stops();
    return 0;
}
