/* Counts the instructions of the core on an emulated microcontroller: 24 channels at 8 kHz, fed through the serial
 * link with what a host sends. It prints a line "NAME COUNT BUDGET" for each figure, and fails where one is above
 * its budget (budgets.h), or where a stream does not play as it should. */
#include <string.h>

#include "../../tactile_link.h"
#include "budgets.h"
#include "machine.h"

#define RATE 8000u
#define TICK_HZ 25000000u
#define PERIOD (TICK_HZ / RATE)
#define BLOCK 16u       /* samples of a PCM packet, 2 ms */
#define FRAME 160u      /* samples from spectrum frame to frame, 20 ms */
#define LEAD 320u       /* samples that are sent ahead, 40 ms */
#define INSTANTS 3200u  /* length of a stream */
#define HEARTBEAT 400u  /* instants from heartbeat to heartbeat, 50 ms */
#define LOST 4u         /* of so many packets the last is lost in the lossy stream */
#define WINDOW_MS 25u   /* of CORRELATION in the guarded stream */
#define GUARDED 12u     /* channels in a GUARD packet */
#define RANGE_UA 2500u
#define SESSION 0x1234u

static ta_amplifier amp;
static ta_serial serial;
static uint64_t tick;
static uint32_t position;
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

static void report(const char *stream, const char *figure, uint32_t value)
{
    char name[48];
    strcpy(name, stream);
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

static void count(counts *c, uint32_t before)
{
    uint32_t spent = ((machine_instructions() - before) & MACHINE_COUNT_MASK) - overhead;
    c->sum += spent;
    c->calls++;
    c->worst = spent > c->worst ? spent : c->worst;
}

static uint32_t mean(const counts *c)
{
    return (uint32_t)((c->sum + c->calls / 2u) / c->calls);
}

/* The board: packets and codes go nowhere, currents are 0. */

static bool send(void *context, const uint8_t *packet, size_t size)
{
    (void)context;
    (void)packet;
    (void)size;
    return true;
}

static void put_out(void *context, uint64_t at, uint32_t of, const int16_t *codes)
{
    (void)context;
    (void)at;
    (void)of;
    (void)codes;
}

static void high_voltage(void *context, bool on)
{
    (void)context;
    (void)on;
}

static bool estop_open(void *context)
{
    (void)context;
    return false;
}

static void currents(void *context, int16_t *codes)
{
    (void)context;
    memset(codes, 0, TA_CHANNELS * sizeof *codes);
}

static bool power_up(bool measures)
{
    static const ta_config config = {
        .node = 1,
        .channels = TA_CHANNELS,
        .carriers = TA_CARRIERS,
        .holds = true,
        .formats = 15,
        .packet_limit = TA_PACKET_MAX,
        .fifo_samples = TA_FIFO,
        .sense_range_ua = RANGE_UA,
        .tick_hz = TICK_HZ,
        .rate_min_hz = 2500,
        .rate_max_hz = RATE,
        .full_scale_uv = 100000000,
        .voltage_limit_uv = 100000000,
        .slew_limit_v_per_s = 700000,
        .fade_limit_us = 20000,
        .name = "budget",
    };
    ta_hal hal = {
        .send = send, .put_out = put_out, .high_voltage = high_voltage, .estop_open = estop_open};
    hal.currents = measures ? currents : NULL;
    if (!ta_init(&amp, &config, &hal)) {
        return false;
    }
    ta_serial_init(&serial, &amp, NULL, NULL);
    tick = 0;
    return true;
}

/* The host */

static uint8_t packet[TA_PACKET_MAX];
static uint8_t coded[TA_COBS_MAX(TA_PACKET_MAX) + 1u];
static uint8_t *const payload = packet + TA_HEADER;

/* Codes the packet with this payload. */
static size_t code(uint8_t type, size_t size)
{
    ta_packet p = {.type = type, .flags = TP_MAJOR << 6, .node = 1, .size = size};
    size_t length = ta_cobs_encode(packet, ta_packet_seal(packet, &p), coded);
    coded[length] = 0;
    return length + 1u;
}

static void request(uint8_t type, size_t size)
{
    ta_serial_feed(&serial, coded, code(type, size), tick);
}

static void begin(uint8_t mode)
{
    uint8_t increments[4u * TA_CARRIERS];
    tp_hello hello = {.session = SESSION, .major = TP_MAJOR};
    tp_arm arm = {.session = SESSION, .mode = mode, .sample_rate_hz = RATE};
    tp_start start = {.session = SESSION, .position = position, .delay_ms = 10};
    tp_carriers carriers = {.session = SESSION,
                            .count = TA_CARRIERS,
                            .increments = increments,
                            .increments_size = sizeof increments};
    for (uint32_t k = 0; k < TA_CARRIERS; k++) {
        tp_put_le(increments + 4u * k, 0x01000000u * (k + 3u), 4);
    }
    request(TP_HELLO, tp_hello_encode(&hello, payload, TA_PACKET_MAX));
    request(TP_CARRIERS, tp_carriers_encode(&carriers, payload, TA_PACKET_MAX));
    request(TP_ARM, tp_arm_encode(&arm, payload, TA_PACKET_MAX));
    request(TP_START, tp_start_encode(&start, payload, TA_PACKET_MAX));
}

static void end(void)
{
    tp_stop stop = {.session = SESSION};
    request(TP_STOP, tp_stop_encode(&stop, payload, TA_PACKET_MAX));
    for (uint32_t i = 0; i < HEARTBEAT; i++) {
        tick += PERIOD;
        ta_run(&amp, tick);
    }
}

/* A triangle of half the full scale, of another frequency in each channel. */
static int16_t triangle(uint32_t channel, uint32_t at)
{
    uint32_t phase = (at * (3u + channel) * 97u) & 0xFFFFu;
    return (int16_t)((phase < 0x8000u ? (int32_t)phase : 0xFFFF - (int32_t)phase) - 0x4000);
}

static size_t pcm_packet(uint8_t format, uint32_t at)
{
    static int16_t codes[BLOCK * TA_CHANNELS];
    static uint8_t data[2u * BLOCK * TA_CHANNELS];
    tp_pcm m = {.position = at,
                .session = SESSION,
                .channels = TA_CHANNELS,
                .format = format,
                .samples = BLOCK,
                .data = data,
                .data_size = ta_samples_size(format, TA_CHANNELS, BLOCK)};
    for (uint32_t i = 0; i < BLOCK * TA_CHANNELS; i++) {
        codes[i] = triangle(i % TA_CHANNELS, at + i / TA_CHANNELS);
    }
    ta_samples_encode(codes, format, TA_CHANNELS, BLOCK, data);
    return code(TP_PCM, tp_pcm_encode(&m, payload, TA_PACKET_MAX));
}

/* Amplitudes 32 to 24 dB below the full scale, and phases, that change from frame to frame; a multiplicative
 * hash takes the place of a generator of random numbers. */
static size_t spectrum_packet(uint32_t at)
{
    static uint8_t envelopes[2u * TA_CHANNELS * TA_CARRIERS];
    tp_spectrum m = {.position = at,
                     .session = SESSION,
                     .valid = 2u * FRAME,
                     .channels = TA_CHANNELS,
                     .format = TP_SAMPLE_FORMAT_SPECTRUM8,
                     .carriers = TA_CARRIERS,
                     .envelopes = envelopes,
                     .envelopes_size = sizeof envelopes};
    for (uint32_t i = 0; i < sizeof envelopes; i++) {
        uint8_t any = (uint8_t)((at / FRAME * 768u + i) * 2654435761u >> 24);
        envelopes[i] = i % 2u == 0 ? (uint8_t)(128u + any % 32u) : any;
    }
    return code(TP_SPECTRUM, tp_spectrum_encode(&m, payload, TA_PACKET_MAX));
}

/* Windows of currents, and guards that are armed and allow everything. */
static void guard(void)
{
    static uint8_t entries[TA_GUARD_ENTRY * GUARDED];
    tp_set set = {.session = SESSION, .parameter = TP_PARAMETER_CORRELATION_MS, .value = WINDOW_MS};
    tp_guard m = {.session = SESSION,
                  .channels = GUARDED,
                  .entries = entries,
                  .entries_size = sizeof entries};
    for (size_t i = 0; i < GUARDED; i++) {
        entries[TA_GUARD_ENTRY * i] = TP_GUARD_FLAG_ARMED;
        memset(entries + TA_GUARD_ENTRY * i + 4, 0xFF, 8);
    }
    request(TP_SET, tp_set_encode(&set, payload, TA_PACKET_MAX));
    for (m.first_channel = 0; m.first_channel < TA_CHANNELS; m.first_channel += GUARDED) {
        request(TP_GUARD, tp_guard_encode(&m, payload, TA_PACKET_MAX));
    }
}

/* Streams */

typedef struct {
    const char *name;
    uint8_t format;
    bool lossy;
    bool guarded;
} stream;

/* Sends what is due, LEAD samples ahead. */
static void send_due(const stream *s, uint32_t *next, counts *packets)
{
    bool spectrum = s->format == TP_SAMPLE_FORMAT_SPECTRUM8;
    while (ta_distance(*next, amp.player.position) < (int32_t)LEAD) {
        size_t size = spectrum ? spectrum_packet(*next) : pcm_packet(s->format, *next);
        if (!s->lossy || *next / BLOCK % LOST != LOST - 1u) {
            uint32_t before = machine_instructions();
            ta_serial_feed(&serial, coded, size, tick);
            count(packets, before);
        }
        *next += spectrum ? FRAME : BLOCK;
    }
}

static void play(const stream *s)
{
    bool spectrum = s->format == TP_SAMPLE_FORMAT_SPECTRUM8;
    counts instants = {0, 0, 0};
    counts packets = {0, 0, 0};
    uint32_t next = position;
    uint32_t lost = amp.counters.lost_samples;
    tp_heartbeat heartbeat = {.session = SESSION};
    begin(spectrum ? TP_MODE_SPECTRUM : TP_MODE_PCM);
    for (uint32_t i = 0; i < INSTANTS; i++) {
        send_due(s, &next, &packets);
        if (i % HEARTBEAT == 0) {
            request(TP_HEARTBEAT, tp_heartbeat_encode(&heartbeat, payload, TA_PACKET_MAX));
        }
        if (s->guarded && i == 0) {
            guard();
        }
        tick += PERIOD;
        uint32_t before = machine_instructions();
        ta_run(&amp, tick);
        count(&instants, before);
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
               RATE * mean(&instants) + RATE / (spectrum ? FRAME : BLOCK) * mean(&packets));
    }
}

static void idle(void)
{
    counts instants = {0, 0, 0};
    for (uint32_t i = 0; i < HEARTBEAT; i++) {
        tick += PERIOD;
        uint32_t before = machine_instructions();
        ta_run(&amp, tick);
        count(&instants, before);
    }
    report("idle", "_mean", mean(&instants));
    report("idle", "_worst", instants.worst);
}

int main(void)
{
    static const stream streams[] = {
        {"pcm16", TP_SAMPLE_FORMAT_PCM16, false, false},
        {"pcm12", TP_SAMPLE_FORMAT_PCM12, false, false},
        {"bfp8", TP_SAMPLE_FORMAT_BFP8, false, false},
        {"spectrum", TP_SAMPLE_FORMAT_SPECTRUM8, false, false},
        {"lossy", TP_SAMPLE_FORMAT_PCM16, true, false},
        {"guarded", TP_SAMPLE_FORMAT_PCM16, false, true},
    };
    machine_begin();
    uint32_t before = machine_instructions();
    overhead = (machine_instructions() - before) & MACHINE_COUNT_MASK;
    good = power_up(false);
    idle();
    for (size_t i = 0; i < sizeof streams / sizeof streams[0]; i++) {
        if (streams[i].guarded) {
            good = power_up(true) && good;
        }
        play(&streams[i]);
    }
    report("stack", "", machine_stack());
    report("ta_amplifier", "", sizeof amp);
    report("ta_serial", "", sizeof serial);
    return good && amp.counters.limited_samples == 0 ? 0 : 1;
}
