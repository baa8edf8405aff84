/* The amplifier on the bench; see the header. */
#include "bench.h"

#include <string.h>

#define GUARDED 12u   /* channels in a GUARD packet */
#define RANGE_UA 2500u
#define SESSION 0x1234u

ta_amplifier amp;
uint64_t tick;
uint32_t position;

bool power_up(const ta_hal *hal)
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
        .name = "bench",
    };
    tick = 0;
    return ta_init(&amp, &config, hal);
}

/* The host */

static uint8_t packet[TA_PACKET_MAX];
static uint8_t *const payload = packet + TA_HEADER;

static void request(uint8_t type, size_t size)
{
    ta_packet p = {.type = type, .flags = TP_MAJOR << 6, .node = 1, .size = size};
    handle(packet, ta_packet_seal(packet, &p));
}

bool is_spectrum(const stream *s)
{
    return s->format == TP_SAMPLE_FORMAT_SPECTRUM8;
}

void start(void)
{
    tp_start m = {.session = SESSION, .position = position, .delay_ms = START_MS};
    request(TP_START, tp_start_encode(&m, payload, TA_PACKET_MAX));
}

void begin(const stream *s)
{
    uint8_t increments[4u * TA_CARRIERS];
    tp_hello hello = {.session = SESSION, .major = TP_MAJOR};
    tp_arm arm = {.session = SESSION, .mode = is_spectrum(s) ? TP_MODE_SPECTRUM : TP_MODE_PCM, .sample_rate_hz = RATE};
    tp_limits limits = {.session = SESSION}; /* 0 keeps a limit */
    tp_carriers carriers = {.session = SESSION,
                            .count = TA_CARRIERS,
                            .increments = increments,
                            .increments_size = sizeof increments};
    for (uint32_t k = 0; k < TA_CARRIERS; k++) {
        tp_put_le(increments + 4u * k, 0x01000000u * (k + 3u), 4);
    }
    request(TP_HELLO, tp_hello_encode(&hello, payload, TA_PACKET_MAX));
    request(TP_LIMITS, tp_limits_encode(&limits, payload, TA_PACKET_MAX));
    request(TP_CARRIERS, tp_carriers_encode(&carriers, payload, TA_PACKET_MAX));
    request(TP_ARM, tp_arm_encode(&arm, payload, TA_PACKET_MAX));
    start();
}

uint32_t first_packet(const stream *s)
{
    return is_spectrum(s) ? position + s->spacing : position;
}

void heartbeat(void)
{
    tp_heartbeat m = {.session = SESSION};
    request(TP_HEARTBEAT, tp_heartbeat_encode(&m, payload, TA_PACKET_MAX));
}

void poll_status(void)
{
    request(TP_POLL, 0);
}

void clear_fault(uint32_t trips)
{
    tp_clear_fault m = {.session = SESSION, .trips = trips};
    request(TP_CLEAR_FAULT, tp_clear_fault_encode(&m, payload, TA_PACKET_MAX));
}

void stop(void)
{
    tp_stop m = {.session = SESSION};
    request(TP_STOP, tp_stop_encode(&m, payload, TA_PACKET_MAX));
}

/* A triangle of half the full scale, of another frequency in each channel. */
static int16_t triangle(uint32_t channel, uint32_t at)
{
    uint32_t phase = (at * (3u + channel) * 97u) & 0xFFFFu;
    return (int16_t)((phase < 0x8000u ? (int32_t)phase : 0xFFFF - (int32_t)phase) - 0x4000);
}

static void send_pcm(uint8_t format, uint32_t at)
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
    request(TP_PCM, tp_pcm_encode(&m, payload, TA_PACKET_MAX));
}

/* Amplitudes 32 to 24 dB below the full scale, and phases, that change from frame to frame; a multiplicative
 * hash takes the place of a generator of random numbers. */
static void send_spectrum(uint32_t at, uint32_t distance)
{
    static uint8_t envelopes[2u * TA_CHANNELS * TA_CARRIERS];
    tp_spectrum m = {.position = at,
                     .session = SESSION,
                     .valid = (uint16_t)(2u * distance),
                     .channels = TA_CHANNELS,
                     .format = TP_SAMPLE_FORMAT_SPECTRUM8,
                     .carriers = TA_CARRIERS,
                     .envelopes = envelopes,
                     .envelopes_size = sizeof envelopes};
    for (uint32_t i = 0; i < sizeof envelopes; i++) {
        uint8_t any = (uint8_t)((at / distance * 768u + i) * 2654435761u >> 24);
        envelopes[i] = i % 2u == 0 ? (uint8_t)(128u + any % 32u) : any;
    }
    request(TP_SPECTRUM, tp_spectrum_encode(&m, payload, TA_PACKET_MAX));
}

void send_packet(const stream *s, uint32_t at)
{
    if (is_spectrum(s)) {
        send_spectrum(at, s->spacing);
    } else {
        send_pcm(s->format, at);
    }
}

void set(uint16_t parameter, uint32_t value)
{
    tp_set m = {.session = SESSION, .parameter = parameter, .value = value};
    request(TP_SET, tp_set_encode(&m, payload, TA_PACKET_MAX));
}

void guard(uint8_t entries[TA_CHANNELS][TA_GUARD_ENTRY])
{
    tp_guard m = {.session = SESSION};
    for (size_t first = 0; first < TA_CHANNELS; first += GUARDED) {
        m.first_channel = (uint8_t)first;
        m.channels = (uint8_t)(TA_CHANNELS - first < GUARDED ? TA_CHANNELS - first : GUARDED);
        m.entries = entries[first];
        m.entries_size = (size_t)TA_GUARD_ENTRY * m.channels;
        request(TP_GUARD, tp_guard_encode(&m, payload, TA_PACKET_MAX));
    }
}

void allow_all(uint8_t entry[TA_GUARD_ENTRY])
{
    memset(entry, 0, TA_GUARD_ENTRY);
    entry[0] = TP_GUARD_FLAG_ARMED;
    memset(entry + 4, 0xFF, 8); /* limit, share and floor */
}
