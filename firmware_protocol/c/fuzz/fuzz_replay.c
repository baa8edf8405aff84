/* The whole amplifier under arbitrary messages, frames, faults and e-stop inputs at arbitrary times. Its HAL aborts
 * where the last stage breaks a promise (fuzz.h).
 *
 * A record is a byte of kind, one of time and one of length, then a payload. The high bits of kind say
 * what the payload is: a message's, which gets a valid header and CRC-32 here, and the session, so that
 * the fuzzer gets past the door; a few numbers, of which `made` makes a message that fits, so that it
 * gets to play; bytes, a frame, a fault or a move of the e-stop button.
 */
#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

typedef struct {
    fuzz_board board;
    ta_serial serial;
    ta_can can;
    uint64_t now;
} bench;

static bool no_bytes(void *context, const uint8_t *bytes, size_t size)
{
    (void)context;
    (void)bytes;
    (void)size;
    return true;
}

static bool no_frame(void *context, const ta_can_frame *frame)
{
    (void)context;
    (void)frame;
    return true;
}

/* Where the payload of a type has the session; none: 255. */
static size_t session_at(uint8_t type)
{
    switch (type) {
    case TP_TIME:
    case TP_SYNC:
    case TP_ESTOP:
    case TP_GET:
    case TP_IDENTIFY:
    case TP_POLL:
        return 255;
    case TP_PCM:
    case TP_SPECTRUM:
        return 4;
    default:
        return 0;
    }
}

/* The low bit of `how` leaves the session as the fuzzer has it; the next chooses the serial link. */
static void message(bench *b, uint8_t type, uint8_t how, const uint8_t *payload, size_t size)
{
    uint8_t bytes[TA_OVERHEAD + 255];
    uint8_t coded[TA_COBS_MAX(sizeof bytes) + 1];
    ta_packet p = {0};
    size_t at = session_at(type);
    p.type = type;
    p.flags = 0x60;
    p.node = 1;
    p.size = size;
    if (size > 0) {
        memcpy(bytes + TA_HEADER, payload, size);
    }
    if ((how & 1u) == 0 && at + 2 <= size) {
        tp_put_le(bytes + TA_HEADER + at, FUZZ_SESSION, 2);
    }
    size_t total = ta_packet_seal(bytes, &p);
    b->board.arming = type == TP_ARM;
    if ((how & 2u) == 0) {
        ta_receive(&b->board.amp, bytes, total, b->now);
    } else {
        size_t length = ta_cobs_encode(bytes, total, coded);
        coded[length] = 0;
        ta_serial_feed(&b->serial, coded, length + 1, b->now);
    }
    b->board.arming = false;
}

/* Bytes of a body, of a seed: any will do. */
static void fill(uint8_t *out, size_t size, uint32_t seed)
{
    for (size_t i = 0; i < size; i++) {
        seed = seed * 1664525u + 1013904223u;
        out[i] = (uint8_t)(seed >> 24);
    }
}

static size_t made_pcm(const ta_player *p, const uint8_t *a, uint8_t *out)
{
    uint8_t first = a[2] % 4u;
    uint8_t channels = (uint8_t)(1u + (unsigned)(a[2] >> 2) % (4u - first));
    uint8_t samples = (uint8_t)(1u + a[1] % 20u);
    uint8_t format = a[3] % 3u;
    size_t size = ta_samples_size(format, channels, samples);
    tp_put_le(out, p->position + a[0] - 16u, 4);
    out[6] = first;
    out[7] = channels;
    out[8] = format;
    out[9] = samples;
    fill(out + TP_PCM_SIZE, size, a[4]);
    return TP_PCM_SIZE + size;
}

static size_t made_frame(const ta_player *p, const uint8_t *a, uint8_t *out)
{
    uint8_t first = a[2] % 4u;
    uint8_t channels = (uint8_t)(1u + (unsigned)(a[2] >> 2) % (4u - first));
    size_t size = 2u * channels * p->carriers;
    tp_put_le(out, p->position + a[0] - 16u, 4);
    tp_put_le(out + 6, 4u * a[1], 2);
    out[8] = first;
    out[9] = channels;
    out[10] = TP_SAMPLE_FORMAT_SPECTRUM8;
    out[11] = p->carriers;
    fill(out + TP_SPECTRUM_SIZE, size, a[4]);
    for (size_t i = 0; i < size; i += 2) { /* loud */
        out[TP_SPECTRUM_SIZE + i] |= a[3];
    }
    return TP_SPECTRUM_SIZE + size;
}

/* Guards that are armed more often than not, with shifts that are possible more often than not. */
static size_t made_guard(const uint8_t *a, uint8_t *out)
{
    uint8_t first = a[0] % 4u;
    uint8_t channels = (uint8_t)(1u + (unsigned)(a[0] >> 2) % (first < 3 ? 2u : 1u));
    out[2] = first;
    out[3] = channels;
    fill(out + TP_GUARD_SIZE, TA_GUARD_ENTRY * channels, a[1]);
    for (size_t i = 0; i < channels; i++) {
        uint8_t *entry = out + TP_GUARD_SIZE + TA_GUARD_ENTRY * i;
        entry[0] = a[2] % 8u != 0 ? TP_GUARD_FLAG_ARMED : entry[0];
        entry[1] = a[3] % 33u;
        entry[2] = a[4] % 33u;
    }
    return TP_GUARD_SIZE + TA_GUARD_ENTRY * channels;
}

static size_t made_mark(const ta_player *p, const uint8_t *a, uint8_t *out)
{
    tp_put_le(out + 2, p->position + a[0] - 16u, 4);
    out[6] = a[1] % 9u;
    tp_put_le(out + 7, a[2] % 32u, 2);
    return TP_MARK_SIZE;
}

/* A payload that fits the type, of five numbers. */
static size_t made(const ta_player *p, uint8_t type, const uint8_t *a, uint8_t *out)
{
    switch (type) {
    case TP_ARM:
        out[2] = a[0] % 2u;
        tp_put_le(out + 3, 2500u + 50u * (uint32_t)a[1], 4);
        return TP_ARM_SIZE;
    case TP_START:
        tp_put_le(out + 2, a[0] * 0x01010101u, 4);
        out[6] = a[1] % 16u;
        return 7;
    case TP_CLEAR_FAULT:
        tp_put_le(out + 2, p->counters->trips, 4);
        return TP_CLEAR_FAULT_SIZE;
    case TP_LIMITS:
        tp_put_le(out + 2, a[0] * 400000u, 4);
        tp_put_le(out + 6, a[1] * 3000u, 4);
        tp_put_le(out + 10, a[2] * 80u, 4);
        return TP_LIMITS_SIZE;
    case TP_SET:
        tp_put_le(out + 2, 1u + a[0] % 9u, 2);
        tp_put_le(out + 4, a[0] % 9u == 8u ? 100u * a[1] : a[1], 4);
        return TP_SET_SIZE;
    case TP_PCM:
        return made_pcm(p, a, out);
    case TP_CARRIERS:
        out[2] = (uint8_t)(1u + a[0] % 3u);
        fill(out + TP_CARRIERS_SIZE, 4u * out[2], a[1]);
        return TP_CARRIERS_SIZE + 4u * out[2];
    case TP_SPECTRUM:
        return made_frame(p, a, out);
    case TP_GUARD:
        return made_guard(a, out);
    case TP_MARK:
        return made_mark(p, a, out);
    default:
        memcpy(out + 2, a, 5);
        return 7;
    }
}

static void make_and_send(bench *b, uint8_t type, const uint8_t *payload, size_t size)
{
    uint8_t numbers[5] = {0};
    uint8_t out[255] = {0};
    memcpy(numbers, payload, size < 5 ? size : 5);
    ta_run(&b->board.amp, b->now);
    message(b, type, 0, out, made(&b->board.amp.player, type, numbers, out));
}

static void frame(bench *b, uint8_t kind, const uint8_t *payload, size_t size)
{
    ta_can_frame f = {0};
    f.id = (uint32_t)(kind & 7u) << 8 | 2u;
    f.size = (uint8_t)(size < 64 ? size : 64);
    memcpy(f.data, payload, f.size);
    ta_can_feed(&b->can, &f, b->now);
}

/* Opens or closes the e-stop input; with 2 in `how` the next instant is what reads it. */
static void move_button(bench *b, uint8_t how)
{
    ta_run(&b->board.amp, b->now);
    b->board.estop_open = (how & 1u) != 0;
    if ((how & 2u) == 0) {
        ta_estop_input(&b->board.amp, b->now);
        HOLDS(!b->board.estop_open || b->board.amp.state == TP_STATE_ESTOP);
    }
}

static void feed(bench *b, uint8_t kind, const uint8_t *payload, size_t size)
{
    uint8_t type = kind & 0x1Fu;
    switch (kind >> 5) {
    case 4:
        ta_serial_feed(&b->serial, payload, size, b->now);
        break;
    case 5:
        frame(b, kind, payload, size);
        break;
    case 6:
        if ((kind & 4u) != 0) {
            move_button(b, kind);
        } else {
            ta_fault(&b->board.amp, kind & 3u, b->now);
        }
        break;
    case 7:
        ta_run(&b->board.amp, b->now);
        break;
    case 2:
    case 3:
        make_and_send(b, type, payload, size);
        break;
    default:
        message(b, type, (uint8_t)(kind >> 5 | (type & 0x10u) >> 3), payload, size);
        break;
    }
}

/* Duties 3, 4 and 10: it is at 0 V and without high voltage 170 ms and a sample after the last heartbeat,
 * and 20 ms and a sample after ESTOP or the opening of the e-stop input. */
static void abandon(bench *b, size_t how)
{
    ta_amplifier *amp = &b->board.amp;
    const uint8_t reason = 1;
    ta_run(amp, b->now);
    amp->config.lateness = 0; /* nothing holds it up any more */
    uint64_t end = fuzz_deadline(&b->board);
    if (how != 0) {
        end = b->now + 20000u + fuzz_period(amp);
    }
    if (how == 1) {
        message(b, TP_ESTOP, 0, &reason, 1);
    } else if (how == 2) {
        move_button(b, 1);
    }
    ta_run(amp, end > b->now ? end : b->now);
    HOLDS(amp->player.silent && !amp->high_voltage);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static bench b;
    static const uint8_t hello[] = {0x34, 0x12, 1};
    size_t at = 0;
    fuzz_power_up(&b.board, 255);
    b.board.amp.config.lateness = size % 2u != 0 ? 20000u : 0u; /* records may be 65 ms apart */
    b.now = 0;
    ta_serial_init(&b.serial, &b.board.amp, no_bytes, NULL);
    ta_can_init(&b.can, &b.board.amp, false, false, no_frame, NULL);
    message(&b, TP_HELLO, 0, hello, sizeof hello);
    while (size - at >= 3) {
        uint8_t kind = data[at];
        size_t length = data[at + 2];
        b.now += (uint64_t)data[at + 1] * data[at + 1];
        at += 3;
        if (length > size - at) {
            length = size - at;
        }
        feed(&b, kind, data + at, length);
        at += length;
    }
    abandon(&b, size % 3u);
    return 0;
}
