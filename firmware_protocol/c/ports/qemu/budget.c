/* Counts the instructions of the core on an emulated microcontroller: 24 channels at 8 kHz, fed through the serial
 * link with what a host sends. It prints a line "NAME COUNT BUDGET" for each figure, and fails where one is above
 * its budget (budgets.h), or where a stream does not play as it should. */
#include <string.h>

#include "../../tactile_link.h"
#include "../../test/board.h"
#include "bench.h"
#include "budgets.h"
#include "machine.h"

#define INSTANTS 3200u /* length of a stream */
#define FRAME 160u     /* samples from spectrum frame to frame, 20 ms */
#define LEAD 320u      /* samples that are sent ahead, 40 ms */
#define LOST 4u        /* of so many packets the last is lost in the lossy stream */
#define WINDOW_MS 25u  /* of CORRELATION in the guarded stream */

static ta_serial serial;
static bool good = true;

/* Figures and their budgets */

static const struct {
    const char *name;
    uint32_t most[2];
} budgets[] = {
#define BUDGET(name, m4, m0) {name, {m4, m0}},
    BUDGETS(BUDGET)
#undef BUDGET
};

static uint32_t budget_of(const char *name)
{
    for (size_t i = 0; i < sizeof budgets / sizeof budgets[0]; i++) {
        if (strcmp(budgets[i].name, name) == 0) {
            return budgets[i].most[PART];
        }
    }
    return 0;
}

static void report(const char *of, const char *figure, uint32_t value)
{
    char name[48];
    strcpy(name, of);
    strcat(name, figure);
    uint32_t most = budget_of(name);
    machine_print(name);
    machine_print(" ");
    machine_print_number(value);
    machine_print(" ");
    machine_print_number(most);
    machine_print(value > most ? " over its budget\n" : "\n");
    good = good && value <= most;
}

/* Mean and worst of the counts of one kind of call. */
typedef struct {
    uint64_t sum;
    uint32_t calls;
    uint32_t worst;
} counts;

static uint32_t overhead; /* instructions between two readings of the counter */

static uint32_t since(uint32_t before)
{
    return ((machine_instructions() - before) & MACHINE_COUNT_MASK) - overhead;
}

static void count(counts *c, uint32_t spent)
{
    c->sum += spent;
    c->calls++;
    c->worst = spent > c->worst ? spent : c->worst;
}

static uint32_t mean(const counts *c)
{
    return (uint32_t)((c->sum + c->calls / 2u) / c->calls);
}

/* The two contexts: ta_run is the interrupt, which is held off from mask to unmask. */

static uint32_t masked_at;
static uint32_t masked_worst;
static uint32_t watching; /* instructions that the two functions below took, which no board has */
static uint32_t watching_once;

static void mask(void *context)
{
    (void)context;
    masked_at = machine_instructions();
}

static void unmask(void *context)
{
    uint32_t spent = since(masked_at);
    (void)context;
    masked_worst = spent > masked_worst ? spent : masked_worst;
    watching += watching_once;
}

static void calibrate(void)
{
    uint32_t before = machine_instructions();
    overhead = (machine_instructions() - before) & MACHINE_COUNT_MASK;
    before = machine_instructions();
    mask(NULL);
    unmask(NULL);
    watching_once = since(before);
    masked_worst = 0;
}

static bool power_up_board(bool measures)
{
    static bool open;
    ta_hal hal = board_hal(&open);
    hal.mask = mask;
    hal.unmask = unmask;
    hal.currents = measures ? board_currents : NULL;
    if (!power_up(&hal)) {
        return false;
    }
    ta_serial_init(&serial, &amp, NULL, NULL);
    return true;
}

/* The serial link */

static uint32_t handled; /* instructions that the latest packet took */

void handle(const uint8_t *packet, size_t size)
{
    static uint8_t coded[TA_COBS_MAX(TA_PACKET_MAX) + 1u];
    size_t length = ta_cobs_encode(packet, size, coded);
    coded[length] = 0;
    watching = 0;
    uint32_t before = machine_instructions();
    ta_serial_feed(&serial, coded, length + 1u, tick);
    handled = since(before) - watching;
}

/* Streams */

static void guard_all(void)
{
    static uint8_t entries[TA_CHANNELS][TA_GUARD_ENTRY];
    for (size_t c = 0; c < TA_CHANNELS; c++) {
        allow_all(entries[c]);
    }
    set(TP_PARAMETER_CORRELATION_MS, WINDOW_MS);
    guard(entries);
}

/* Sends what is due, LEAD samples ahead. */
static void send_due(const stream *s, uint32_t *next, counts *packets)
{
    while (ta_distance(*next, amp.player.position) < (int32_t)LEAD) {
        if (!s->lossy || *next / BLOCK % LOST != LOST - 1u) {
            send_packet(s, *next);
            count(packets, handled);
        }
        *next += s->spacing;
    }
}

static void instant(counts *instants)
{
    tick += PERIOD;
    uint32_t before = machine_instructions();
    ta_run(&amp, tick);
    count(instants, since(before));
    ta_serve(&amp);
}

static void end(void)
{
    counts unused = {0, 0, 0};
    stop();
    for (uint32_t i = 0; i < HEARTBEAT; i++) {
        instant(&unused);
    }
}

static void play(const stream *s)
{
    counts instants = {0, 0, 0};
    counts packets = {0, 0, 0};
    uint32_t next = first_packet(s);
    uint32_t lost = amp.counters.lost_samples;
    begin(s);
    for (uint32_t i = 0; i < INSTANTS; i++) {
        send_due(s, &next, &packets);
        if (i % HEARTBEAT == 0) {
            heartbeat();
            poll_status();
        }
        if (s->guarded && i == 0) {
            guard_all();
        }
        instant(&instants);
    }
    lost = amp.counters.lost_samples - lost;
    good = good && amp.player.phase == TP_PHASE_PLAYING && (lost > 0) == s->lossy;
    end();
    position = next + (1u << 20);
    report(s->name, "_mean", mean(&instants));
    report(s->name, "_worst", instants.worst);
    if (!s->lossy && !s->guarded) {
        report(s->name, "_packet_mean", mean(&packets));
        report(s->name, "_packet_worst", packets.worst);
        report(s->name, "_per_second",
               RATE * mean(&instants) + RATE / s->spacing * mean(&packets));
    }
}

static void idle(void)
{
    counts instants = {0, 0, 0};
    for (uint32_t i = 0; i < HEARTBEAT; i++) {
        instant(&instants);
    }
    report("idle", "_mean", mean(&instants));
    report("idle", "_worst", instants.worst);
}

/* After a stall all instants but the latest are skipped. */
static void skip(void)
{
    amp.config.lateness = PERIOD / 2u;
    tick += PERIOD * INSTANTS;
    uint32_t before = machine_instructions();
    ta_run(&amp, tick);
    report("skipped", "_mean", since(before) / INSTANTS);
    amp.config.lateness = 0;
}

int main(void)
{
    static const stream streams[] = {
        {"pcm16", TP_SAMPLE_FORMAT_PCM16, BLOCK, false, false},
        {"pcm12", TP_SAMPLE_FORMAT_PCM12, BLOCK, false, false},
        {"bfp8", TP_SAMPLE_FORMAT_BFP8, BLOCK, false, false},
        {"spectrum", TP_SAMPLE_FORMAT_SPECTRUM8, FRAME, false, false},
        {"lossy", TP_SAMPLE_FORMAT_PCM16, BLOCK, true, false},
        {"guarded", TP_SAMPLE_FORMAT_PCM16, BLOCK, false, true},
    };
    machine_begin();
    calibrate();
    good = power_up_board(false);
    idle();
    skip();
    for (size_t i = 0; i < sizeof streams / sizeof streams[0]; i++) {
        if (streams[i].guarded) {
            good = power_up_board(true) && good;
        }
        play(&streams[i]);
    }
    report("masked", "_worst", masked_worst);
    report("stack", "", machine_stack());
    report("ta_amplifier", "", sizeof amp);
    report("ta_serial", "", sizeof serial);
    return good && amp.counters.limited_samples == 0 ? 0 : 1;
}
