/* Self-test of the core against closed forms: published examples, symmetries, edges. Prints nothing and
 * exits 0, or says which line does not hold. */
#include <stdio.h>
#include <stdlib.h>

#include "../tactile_internal.h"
#include "../tactile_link.h"
#include "board.h"

static int failures;

#define CHECK(condition)                                                                          \
    do {                                                                                          \
        if (!(condition)) {                                                                       \
            fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #condition);                       \
            failures++;                                                                           \
        }                                                                                         \
    } while (0)

/* The check value that catalogs of CRCs give for CRC-32. */
static void test_crc(void)
{
    CHECK(ta_crc32((const uint8_t *)"123456789", 9) == 0xCBF43926u);
    CHECK(ta_crc32((const uint8_t *)"", 0) == 0);
}

static void test_packet(void)
{
    uint8_t bytes[16] = {0, 0, 0, 0, 0xAA, 0xBB};
    ta_packet sent = {0};
    ta_packet got;
    sent.type = 0x12;
    sent.flags = 0x60;
    sent.node = 127;
    sent.seq = 255;
    sent.size = 2;
    CHECK(ta_packet_seal(bytes, &sent) == 10);
    CHECK(ta_packet_decode(&got, bytes, 10));
    CHECK(got.type == 0x12 && got.flags == 0x60 && got.node == 127 && got.seq == 255);
    CHECK(got.size == 2 && got.payload == bytes + 4 && got.payload[1] == 0xBB);
    CHECK(!ta_packet_decode(&got, bytes, 7));
    for (size_t bit = 0; bit < 80; bit++) { /* CRC-32 finds every single bit */
        bytes[bit / 8] ^= (uint8_t)(1u << bit % 8);
        CHECK(!ta_packet_decode(&got, bytes, 10));
        bytes[bit / 8] ^= (uint8_t)(1u << bit % 8);
    }
}

static void cobs_case(const uint8_t *plain, size_t size, const uint8_t *coded, size_t length)
{
    static ta_cobs cobs;
    uint8_t out[600];
    ta_cobs_event event;
    CHECK(ta_cobs_encode(plain, size, out) == length);
    CHECK(memcmp(out, coded, length) == 0);
    out[length] = 0;
    out[length + 1] = 1; /* of the next frame */
    for (size_t piece = 1; piece <= length + 2; piece++) {
        size_t taken = 0;
        ta_cobs_init(&cobs, size > 0 ? size : 1);
        do {
            size_t left = length + 2 - taken;
            taken += ta_cobs_feed(&cobs, out + taken, left < piece ? left : piece, &event);
            CHECK(event == (taken <= length ? TA_COBS_MORE : TA_COBS_FRAME));
        } while (taken <= length);
        CHECK(taken == length + 1);
        CHECK(cobs.frame == size && memcmp(cobs.bytes, plain, size) == 0);
    }
}

/* The example of Cheshire & Baker 1999, the start of an IP packet, and runs as long as the longest
 * block. */
static void test_cobs(void)
{
    static const uint8_t example[] = {0x45, 0x00, 0x00, 0x2C, 0x4C, 0x79, 0x00, 0x00,
                                      0x40, 0x06, 0x4F, 0x37};
    static const uint8_t coded[] = {0x02, 0x45, 0x01, 0x04, 0x2C, 0x4C, 0x79, 0x01,
                                    0x05, 0x40, 0x06, 0x4F, 0x37};
    static const uint8_t zeros[] = {0, 0};
    static const uint8_t coded_zeros[] = {1, 1, 1};
    uint8_t run[256];
    uint8_t block[258];
    cobs_case(example, sizeof example, coded, sizeof coded);
    cobs_case(zeros, 0, coded_zeros, 1);
    cobs_case(zeros, 1, coded_zeros, 2);
    cobs_case(zeros, 2, coded_zeros, 3);
    for (size_t i = 0; i < 255; i++) {
        run[i] = (uint8_t)(i + 1);
        block[i + 1] = (uint8_t)(i + 1);
    }
    block[0] = 254; /* 253 bytes */
    cobs_case(run, 253, block, 254);
    block[0] = 255; /* 254: the longest block stands for no zero */
    cobs_case(run, 254, block, 255);
    block[255] = 2; /* 255: another follows */
    block[256] = 255;
    cobs_case(run, 255, block, 257);
    run[254] = 0; /* 254 and a zero: two empty blocks */
    block[255] = 1;
    block[256] = 1;
    cobs_case(run, 255, block, 257);
}

static ta_cobs_event fed(ta_cobs *cobs, uint8_t byte)
{
    ta_cobs_event event;
    size_t taken = ta_cobs_feed(cobs, &byte, 1, &event);
    CHECK(taken == 1 || event == TA_COBS_OVERSIZED);
    return event;
}

static void test_cobs_errors(void)
{
    static ta_cobs cobs;
    int oversized = 0;
    ta_cobs_init(&cobs, 64);
    CHECK(fed(&cobs, 0) == TA_COBS_MORE); /* nothing between two zeros */
    CHECK(fed(&cobs, 3) == TA_COBS_MORE);
    CHECK(fed(&cobs, 1) == TA_COBS_MORE);
    CHECK(fed(&cobs, 0) == TA_COBS_MALFORMED); /* the block is one byte short */
    for (size_t i = 0; i < 500; i++) {
        oversized += fed(&cobs, 9) == TA_COBS_OVERSIZED;
    }
    CHECK(oversized == 1);
    CHECK(fed(&cobs, 0) == TA_COBS_MORE);
    CHECK(fed(&cobs, 1) == TA_COBS_MORE);
    CHECK(fed(&cobs, 0) == TA_COBS_FRAME && cobs.frame == 0); /* good again */
}

/* A packet cut for 8, 32 and 64 bytes comes together; every fragment but the last is full. */
static void test_fragments(size_t size, size_t room)
{
    static ta_reassembly r;
    uint8_t packet[255];
    uint8_t part[64];
    uint32_t dropped = 0;
    ta_cutter cutter = {0};
    const ta_transfer *whole = NULL;
    for (size_t i = 0; i < size; i++) {
        packet[i] = (uint8_t)(7 * i);
    }
    ta_reassembly_init(&r, 255, 1000000, &dropped);
    cutter.packet = packet;
    cutter.size = size;
    cutter.id = 31;
    for (size_t n = 0; whole == NULL; n++) {
        size_t got = ta_cut(&cutter, part, room);
        bool end = (part[0] & TA_FRAGMENT_END) != 0;
        CHECK(got == room || end);
        CHECK((part[0] & TA_FRAGMENT_START ? 1 : 0) == (n == 0));
        CHECK((part[0] & TA_FRAGMENT_TOGGLE ? 1u : 0u) == n % 2);
        whole = ta_reassembly_feed(&r, 0x302, part, got, false, 19999);
        CHECK(end == (whole != NULL));
    }
    CHECK(whole->size == size && memcmp(whole->bytes, packet, size) == 0);
    CHECK(ta_cut(&cutter, part, room) == 0 && dropped == 0);
}

/* Fragments that change places are found by their toggle, though all bytes come. */
static void test_reordered(void)
{
    static ta_reassembly r;
    static const size_t order[] = {0, 2, 1, 3};
    uint8_t packet[26] = {0};
    uint8_t parts[4][8];
    size_t sizes[4];
    uint32_t dropped = 0;
    ta_cutter cutter = {0};
    cutter.packet = packet;
    cutter.size = sizeof packet;
    for (size_t i = 0; i < 4; i++) {
        sizes[i] = ta_cut(&cutter, parts[i], 8);
    }
    ta_reassembly_init(&r, 255, 1000000, &dropped);
    for (size_t i = 0; i < 4; i++) {
        size_t k = order[i];
        CHECK(ta_reassembly_feed(&r, 0x402, parts[k], sizes[k], false, 0) == NULL);
    }
    CHECK(dropped == 3); /* the transfer, and two fragments that then belong to none */
}

static void test_fd_lengths(void)
{
    CHECK(ta_can_fd_length(0) == 0 && ta_can_fd_length(8) == 8 && ta_can_fd_length(9) == 12);
    CHECK(ta_can_fd_length(25) == 32 && ta_can_fd_length(33) == 48);
    CHECK(ta_can_fd_length(49) == 64 && ta_can_fd_length(64) == 64);
}

static int32_t sine(uint32_t angle)
{
    return -ta_turn(angle).q;
}

static int32_t cosine(uint32_t angle)
{
    return ta_turn(angle).i;
}

/* 10.1: odd about half a turn, even about a quarter, and at most 1 off in sin^2 + cos^2. */
static void test_sine(void)
{
    CHECK(sine(0) == 0 && sine(1u << 30) == 32767);
    CHECK(sine(2u << 30) == 0 && sine(3u << 30) == -32767);
    CHECK(cosine(0) == 32767 && cosine(2u << 30) == -32767);
    CHECK(sine(1u << 21) == 101 && sine(0u - (1u << 21)) == -100); /* 100.5 up */
    CHECK(sine(1u << 22) == 201 && sine(128u << 22) == 23170); /* 32767 sin(pi/4) */
    for (uint32_t k = 0; k < 1024; k++) {
        uint32_t angle = k << 22;
        CHECK(sine(angle + (2u << 30)) == -sine(angle));
        CHECK(sine((2u << 30) - angle) == sine(angle));
        CHECK(cosine(angle) == sine(angle + (1u << 30)));
        int64_t square = (int64_t)sine(angle) * sine(angle) +
                         (int64_t)cosine(angle) * cosine(angle);
        CHECK(llabs(square - 32767LL * 32767LL) <= 32767 * 2);
    }
    for (uint32_t i = 0; i < 4096; i++) { /* rises through the first quarter, interpolated */
        CHECK(sine(i << 18) <= sine((i + 1) << 18));
    }
}

/* 10.2: 80 steps are a factor of 10, 0 is off, 255 full scale. */
static void test_amplitudes(void)
{
    CHECK(ta_amplitude(0) == 0 && ta_amplitude(255) == 32767 * 256);
    CHECK(ta_amplitude(175) == 838835 && ta_amplitude(95) == 83884 && ta_amplitude(15) == 8388);
    for (int c = 2; c < 256; c++) {
        CHECK(ta_amplitude((uint8_t)c) > ta_amplitude((uint8_t)(c - 1)));
    }
    ta_phasor p = ta_phasor_decode(255, 64); /* a quarter turn */
    CHECK(p.i == 0 && p.q == (int32_t)((8388352LL * 32767 + 16384) >> 15));
}

/* A frame of one carrier at a position, with the largest amplitude. */
static ta_frame_fate offer(ta_envelope *e, uint32_t position, uint32_t n, uint32_t fifo)
{
    static const uint8_t codes[] = {255, 0};
    ta_frame *frame;
    ta_frame_fate fate = ta_envelope_offer(e, position, n, fifo, &frame);
    if (frame != NULL) {
        ta_frame_decode(frame, 2, codes, 1);
        CHECK(ta_envelope_keep(e, frame, n) == TA_FRAME_KEPT);
    }
    return fate;
}

/* A frame, its ramp, its end in force and the expiry after `valid` (10.3). The carrier stands at its cosine's
 * top, so that the value is the envelope. */
static void test_envelope(void)
{
    static ta_envelope e;
    ta_phasor full = ta_phasor_decode(255, 0);
    ta_phasor top = ta_turn(0);
    ta_envelope_clear(&e);
    CHECK(offer(&e, 0xFFFFFFFFu, 0xFFFFFFFFu, 100) == TA_FRAME_LATE); /* positions wrap */
    CHECK(offer(&e, 3, 0xFFFFFFFFu, 4) == TA_FRAME_FUTURE);
    CHECK(!ta_envelope_ready(&e, 0xFFFFFFFFu, false));
    CHECK(offer(&e, 3, 0xFFFFFFFFu, 5) == TA_FRAME_KEPT);
    for (uint32_t i = 0; i < 4; i++) {
        CHECK(ta_envelope_ready(&e, 0xFFFFFFFFu + i, i > 0));
        int16_t value = ta_envelope_next(&e, 0xFFFFFFFFu + i, i > 0, &top, 1);
        CHECK(e.present[0].i == full.i / 4 * (int32_t)i);
        CHECK(value == (int16_t)ta_rounded((int64_t)full.i / 4 * (int64_t)i * 32767, 23));
        CHECK(value == ta_envelope_value(&e, &top, 1));
    }
    CHECK(offer(&e, 3, 3, 5) == TA_FRAME_LATE); /* not after the ramp's end */
    CHECK(ta_envelope_next(&e, 3, true, &top, 1) == ta_rounded((int64_t)full.i * 32767, 23));
    CHECK(!e.ramping && e.present[0].i == full.i && e.present[0].q == full.q);
    CHECK(ta_envelope_ready(&e, 4, true));
    (void)ta_envelope_next(&e, 4, true, &top, 1);
    CHECK(!ta_envelope_ready(&e, 5, true));
}

/* The queue holds the four next; a fifth is the last or drops the last. They are played in their order. */
static void test_queue(void)
{
    static ta_envelope e;
    ta_phasor top = ta_turn(0);
    static const uint32_t order[] = {40, 20, 30, 50};
    ta_envelope_clear(&e);
    for (size_t i = 0; i < 4; i++) {
        CHECK(offer(&e, order[i], 0, 1000) == TA_FRAME_KEPT);
    }
    CHECK(offer(&e, 50, 0, 1000) == TA_FRAME_KEPT && e.queued == 4);
    CHECK(offer(&e, 60, 0, 1000) == TA_FRAME_FUTURE);
    CHECK(offer(&e, 10, 0, 1000) == TA_FRAME_FUTURE);
    for (uint32_t n = 0; n < 40; n++) {
        (void)ta_envelope_next(&e, n, n > 0, &top, 1);
        CHECK(e.frames[e.order[0]].position == n / 10 * 10 + 10);
        CHECK(e.queued == 3 - n / 10);
    }
    CHECK(offer(&e, 70, 39, 1000) == TA_FRAME_KEPT && offer(&e, 60, 39, 1000) == TA_FRAME_KEPT);
    ta_envelope_stop(&e, 60);
    CHECK(!e.ramping && e.queued == 1 && e.frames[e.order[1]].position == 70);
}

/* The code of a body of one sample. */
static int16_t decoded(const ta_samples *s)
{
    int16_t code;
    ta_samples_row(s, 0, &code);
    return code;
}

static int16_t through(int16_t code, uint8_t format)
{
    uint8_t data[3] = {0};
    ta_samples s = {0};
    s.format = format;
    s.channels = 1;
    s.samples = 1;
    s.data = data;
    ta_samples_encode(&code, format, 1, 1, data);
    return decoded(&s);
}

/* Every code through every format is as near as the format can be; the edges of section 9. */
static void test_samples(void)
{
    uint8_t pair[3];
    static const int16_t two[] = {16, -16};
    ta_samples s = {TP_SAMPLE_FORMAT_PCM16, 1, 1, pair};
    for (int32_t code = -32767; code <= 32767; code++) {
        int16_t c = (int16_t)code;
        CHECK(through(c, TP_SAMPLE_FORMAT_PCM16) == c);
        CHECK(abs(through(c, TP_SAMPLE_FORMAT_PCM12) - c) <= (abs(c) > 32752 ? 15 : 8));
        CHECK(abs(through(c, TP_SAMPLE_FORMAT_BFP8) - c) <= (abs(c) > 32640 ? 255 : 128));
        CHECK(abs(c) > 127 || through(c, TP_SAMPLE_FORMAT_BFP8) == c);
    }
    tp_put_le(pair, 0x8000, 2);
    CHECK(decoded(&s) == -32767);
    s.format = TP_SAMPLE_FORMAT_PCM12;
    tp_put_le(pair, 0x800, 2);
    CHECK(decoded(&s) == -2047 * 16);
    ta_samples_encode(two, TP_SAMPLE_FORMAT_PCM12, 2, 1, pair); /* 001 and FFF */
    CHECK(pair[0] == 0x01 && pair[1] == 0xF0 && pair[2] == 0xFF);
}

static void test_bfp8(void)
{
    uint8_t data[2] = {8, 0x80};
    int16_t codes[33] = {0};
    uint8_t out[35];
    ta_samples s = {TP_SAMPLE_FORMAT_BFP8, 1, 1, data};
    CHECK(decoded(&s) == -32767); /* -128 x 256, clamped */
    data[0] = 255;                             /* reads as 8 */
    data[1] = 127;
    CHECK(decoded(&s) == 127 * 256);
    CHECK(ta_samples_size(TP_SAMPLE_FORMAT_BFP8, 3, 32) == 99);
    CHECK(ta_samples_size(TP_SAMPLE_FORMAT_BFP8, 3, 33) == 105);
    codes[0] = 128; /* needs exponent 1; the block after it does not */
    codes[32] = -127;
    ta_samples_encode(codes, TP_SAMPLE_FORMAT_BFP8, 1, 33, out);
    CHECK(out[0] == 1 && out[1] == 64 && out[33] == 0 && out[34] == 0x81);
    codes[0] = 255; /* 127.5 rounds up to 128: exponent 2 */
    codes[1] = -255;
    ta_samples_encode(codes, TP_SAMPLE_FORMAT_BFP8, 2, 1, out);
    CHECK(out[0] == 2 && out[2] == 1 && out[3] == 0x81); /* -127.5 rounds up to -127 */
}

static void test_arithmetic(void)
{
    CHECK(ta_distance(0, 0xFFFFFFFFu) == 1 && ta_distance(0xFFFFFFFFu, 0) == -1);
    CHECK(ta_distance(0x80000000u, 0) == INT32_MIN && ta_distance(0x7FFFFFFFu, 0) == INT32_MAX);
    CHECK(ta_shift_right(-1, 8) == -1 && ta_shift_right(-256, 8) == -1);
    CHECK(ta_shift_right(-257, 8) == -2 && ta_shift_right(255, 8) == 0);
    CHECK(ta_clamp(-5, 3) == -3 && ta_clamp(5, 3) == 3 && ta_clamp(2, 3) == 2);
    CHECK(ta_elapsed(150000, 0, 150, 1000000) && !ta_elapsed(149999, 0, 150, 1000000));
}

/* Keeps the samples of one channel, from a position on. */
static void keep(ta_player *p, uint32_t position, uint8_t channel, const ta_samples *s)
{
    ta_set channels = {{0}};
    ta_set_add(&channels, channel);
    for (uint8_t i = 0; i < s->samples; i++) {
        int16_t *codes = ta_player_row(p, position + i);
        if (codes != NULL) {
            ta_samples_row(s, i, codes + channel);
            ta_player_keep_row(p, position + i, &channels);
        }
    }
}

/* 11.2: the clamp comes before the gain. 8.2: only what is kept makes a channel active. START leaves
 * nothing of what was kept, wherever the head of the buffer is. */
static void test_player(void)
{
    static ta_player p;
    ta_counters counters = {0};
    static const uint8_t data[] = {0xA0, 0x0F, 0xA0, 0x0F, 0x60, 0xF0}; /* 4000, 4000, -4000 */
    static const int16_t fade[] = {750, -500, -250, 0};
    ta_samples s = {TP_SAMPLE_FORMAT_PCM16, 1, 3, data};
    ta_player_init(&p, &counters, 2, 8);
    p.rate = 8000;
    p.limit = 1000;
    p.step = 65534;
    p.gain_full = 4;
    ta_player_clear(&p);
    ta_player_start(&p, 100);
    keep(&p, 97, 1, &s);
    keep(&p, 108, 1, &s);
    CHECK(!ta_set_has(&p.active, 1) && p.fill == 0);
    CHECK(counters.late_samples == 3 && counters.future_samples == 3);
    keep(&p, 101, 0, &s);
    CHECK(ta_set_has(&p.active, 0) && p.fill == 4);
    keep(&p, 100, 0, &s); /* 4000, 4000, -4000, -4000 */
    ta_player_instant(&p, TP_STATE_RUNNING, true);
    CHECK(p.codes[0] == 1000 && p.codes[1] == 0);
    for (size_t i = 0; i < 4; i++) {
        ta_player_move(&p, false);
        ta_player_instant(&p, TP_STATE_RAMPDOWN, true);
        CHECK(p.codes[0] == fade[i]);
    }
    CHECK(counters.limited_samples == 4); /* not at gain 0 */
    keep(&p, 109, 0, &s);
    ta_player_clear(&p);
    ta_player_start(&p, 7);
    for (size_t i = 0; i < 8; i++) {
        CHECK(ta_set_empty(&p.present[i]));
    }
}

/* A channel that plays 1000 for 40 samples, from position 100 on, with a fade of four samples. */
static void play_constant(ta_player *p, ta_counters *counters)
{
    static uint8_t data[2 * 40];
    ta_samples s = {TP_SAMPLE_FORMAT_PCM16, 1, 40, data};
    for (size_t i = 0; i < 40; i++) {
        tp_put_le(data + 2 * i, 1000, 2);
    }
    ta_player_init(p, counters, 1, 64);
    p->rate = 8000;
    p->limit = 32767;
    p->step = 65534;
    p->gain_full = 4;
    ta_player_clear(p);
    ta_player_start(p, 100);
    keep(p, 100, 0, &s);
}

static void check_fade(ta_player *p, uint8_t state, const int16_t *codes, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        ta_player_instant(p, state, true);
        CHECK(p->codes[0] == codes[i]);
        ta_player_move(p, false);
    }
}

/* 7.1: ten instants that are skipped are an underrun of ten samples, from which it fades out and in. */
static void test_skipped_samples(void)
{
    static ta_player p;
    static const int16_t fades[] = {750, 500, 250, 0, 250, 500, 750, 1000, 1000};
    static const int16_t plays[] = {1000, 1000};
    ta_counters counters = {0};
    play_constant(&p, &counters);
    check_fade(&p, TP_STATE_RUNNING, plays, 2);
    for (size_t i = 0; i < 10; i++) {
        ta_player_skip(&p, TP_STATE_RUNNING, false);
        CHECK(p.codes[0] == 1000);
    }
    CHECK(p.position == 112 && counters.underruns == 1 && counters.lost_samples == 10);
    check_fade(&p, TP_STATE_RUNNING, fades, 9);
    CHECK(counters.underruns == 1 && counters.lost_samples == 14);
    CHECK(counters.late_samples + counters.future_samples + counters.limited_samples == 0);
    play_constant(&p, &counters);
    check_fade(&p, TP_STATE_RUNNING, plays, 2);
    ta_player_skip(&p, TP_STATE_RAMPDOWN, false);
    check_fade(&p, TP_STATE_RAMPDOWN, fades, 4);
    CHECK(counters.underruns == 1 && counters.lost_samples == 14); /* of RUNNING alone */
    play_constant(&p, &counters);
    ta_player_skip(&p, TP_STATE_RUNNING, true); /* before T the position stays, and all begins as if in time */
    check_fade(&p, TP_STATE_RUNNING, plays, 2);
    CHECK(counters.underruns == 1 && counters.lost_samples == 14);
}

/* 10.3: the envelope on its way to a frame stays where it is, however many positions are skipped. */
static void test_skipped_frames(void)
{
    static ta_player p;
    ta_counters counters = {0};
    ta_player_init(&p, &counters, 1, 64);
    p.rate = 8000;
    p.limit = 32767;
    p.step = 65534;
    p.gain_full = 4;
    p.carriers = 1;
    p.mode = TP_MODE_SPECTRUM;
    ta_player_clear(&p);
    ta_player_start(&p, 0);
    ta_frame *frame = ta_player_frame(&p, 0, 10);
    static const uint8_t loud[] = {255, 0};
    ta_frame_decode(frame, 100, loud, 1);
    ta_player_keep_frame(&p, 0, frame);
    for (uint32_t n = 0; n < 5; n++) {
        ta_player_instant(&p, TP_STATE_RUNNING, true);
        ta_player_move(&p, false);
    }
    int32_t envelope = p.kept.envelopes[0].present[0].i;
    CHECK(envelope == ta_phasor_decode(255, 0).i / 10 * 4);
    for (uint32_t n = 0; n < 20; n++) {
        ta_player_skip(&p, TP_STATE_RUNNING, false);
    }
    int16_t before = p.codes[0];
    ta_player_instant(&p, TP_STATE_RUNNING, true);
    CHECK(p.kept.envelopes[0].present[0].i == envelope && p.codes[0] == before * 3 / 4);
    CHECK(p.phase == TP_PHASE_STARVED && counters.underruns == 1 && counters.lost_samples == 21);
}

/* Who never calls ta_estop_input has the contact read at each instant (6.3), and a contact that bounces
 * counts as open until it has been closed for 50 ms. */
static void test_input_is_read_at_instants(void)
{
    static ta_amplifier amp;
    bool open = false;
    ta_hal hal = board_hal(&open);
    ta_config config = {0};
    config.node = 1;
    config.channels = 1;
    config.packet_limit = 136;
    config.fifo_samples = 512;
    config.tick_hz = 1000000;
    config.rate_min_hz = 8000;
    config.rate_max_hz = 8000;
    config.full_scale_uv = 100000000;
    config.voltage_limit_uv = 100000000;
    config.slew_limit_v_per_s = 700000;
    config.formats = 1;
    CHECK(ta_init(&amp, &config, &hal));
    ta_run(&amp, 1000);
    open = true;
    ta_run(&amp, 1124); /* between two instants */
    CHECK(amp.state == TP_STATE_IDLE);
    ta_run(&amp, 1125);
    CHECK(amp.state == TP_STATE_ESTOP && amp.counters.trips == 1);
    open = false;
    ta_run(&amp, 2000);
    open = true;
    ta_run(&amp, 3000);
    open = false;
    ta_run(&amp, 4000); /* the first instant after the closing is at 3125 */
    CHECK(amp.counters.trips == 2);
    CHECK(ta_input_open(&amp, 53124) && !ta_input_open(&amp, 53125));
    CHECK(amp.state == TP_STATE_ESTOP);
}

static bool named(const ta_config *c, const ta_hal *hal, const char *field)
{
    static ta_amplifier amp;
    const char *field_at_fault = ta_config_fault(c, hal, NULL);
    CHECK(ta_init(&amp, c, hal) == (field_at_fault == NULL));
    return field_at_fault != NULL && strcmp(field_at_fault, field) == 0;
}

static ta_config good_config(void)
{
    ta_config good = {0};
    good.node = 1;
    good.channels = 1;
    good.formats = 1;
    good.packet_limit = 136;
    good.fifo_samples = 512;
    good.tick_hz = 1000000;
    good.rate_min_hz = 2500;
    good.rate_max_hz = 8000;
    good.full_scale_uv = 100000000;
    good.voltage_limit_uv = 100000000;
    good.slew_limit_v_per_s = 5104; /* 656 codes a sample at 2549 Hz, 50 samples; 655 at 5103 */
    good.fade_limit_us = 20000;
    return good;
}

/* What an amplifier puts out, and when. */
static uint32_t put_outs;
static uint64_t first_put_out;

static void count_put_out(void *context, uint64_t tick, uint32_t position, const int16_t *codes)
{
    (void)context;
    (void)position;
    (void)codes;
    first_put_out = put_outs++ == 0 ? tick : first_put_out;
}

/* Amplifiers that skip have the same clock as one that is in time: by a tick and a rate that have no common
 * divisor, and beyond a START. */
static void test_skipping_keeps_the_clock(void)
{
    static ta_amplifier in_time;
    static ta_amplifier late;
    bool open = false;
    ta_hal hal = board_hal(&open);
    ta_config config = good_config();
    config.tick_hz = 1000003;
    CHECK(ta_init(&in_time, &config, &hal));
    hal.put_out = count_put_out;
    config.lateness = 300;
    CHECK(ta_init(&late, &config, &hal));
    ta_amplifier *both[] = {&in_time, &late};
    for (size_t i = 0; i < 2; i++) {
        ta_run(both[i], 1000);
        both[i]->state = TP_STATE_RUNNING;
        both[i]->start_pending = true;
        both[i]->start_tick = 5001;
        ta_player_start(&both[i]->player, 77);
    }
    put_outs = 0;
    ta_run(&in_time, 400001);
    ta_run(&late, 400001); /* 5001 + floor(3159 x 1000003 / 8000) is 399877 */
    CHECK(put_outs == 2 && first_put_out == 399752);
    CHECK(late.next == in_time.next && late.remainder == in_time.remainder);
    CHECK(late.last_tick == in_time.last_tick && late.last_position == in_time.last_position);
    CHECK(late.player.position == in_time.player.position && !late.start_pending);
    put_outs = 0;
    ta_run(&late, late.next + 300); /* as late as it may be */
    CHECK(put_outs == 3 && first_put_out == in_time.next);
}

/* 16: no window has a position whose current was not measured. */
static void test_skipping_ends_the_window(void)
{
    static ta_amplifier amp;
    bool open = false;
    ta_hal hal = board_hal(&open);
    ta_config config = good_config();
    hal.put_out = count_put_out;
    hal.currents = board_currents;
    config.sense_range_ua = 2500;
    config.lateness = 300;
    CHECK(ta_init(&amp, &config, &hal));
    amp.state = TP_STATE_RUNNING;
    amp.correlation_ms = 10;
    ta_run(&amp, 300);
    const ta_window *window = &amp.correlator.windows[amp.correlator.open];
    CHECK(window->position == 0 && amp.correlator.left == 80 - 2);
    put_outs = 0;
    ta_run(&amp, 5000);
    CHECK(put_outs == 3 && window->position == amp.last_position - 2 && amp.correlator.left == 80 - 3);
}

/* What an amplifier of marks did, an entry per instant from its START on, and what it reported. */
#define MARKED_MOST 200
#define MARKED_PACKET 200

typedef struct {
    ta_amplifier amp;
    uint8_t lines; /* that were set last */
    size_t sets;   /* calls that did so */
    size_t instants;
    uint8_t shown[MARKED_MOST];
    uint32_t positions[MARKED_MOST];
    size_t marked;
    tp_marked reports[MARKED_MOST];
    uint8_t refused; /* code of the latest NAK */
    uint32_t detail;
} marked_board;

static bool take_report(void *context, const uint8_t *packet, size_t size)
{
    marked_board *b = context;
    ta_packet p;
    tp_nak nak;
    CHECK(ta_packet_decode(&p, packet, size));
    if (p.type == TP_MARKED) {
        CHECK(p.size == TP_MARKED_SIZE);
        CHECK(tp_marked_decode(&b->reports[b->marked++], p.payload, p.size));
    } else if (p.type == TP_NAK && tp_nak_decode(&nak, p.payload, p.size)) {
        b->refused = nak.code;
        b->detail = nak.detail;
    }
    return true;
}

static void take_lines(void *context, uint8_t lines)
{
    marked_board *b = context;
    CHECK(lines != b->lines);
    b->lines = lines;
    b->sets++;
}

static void take_instant(void *context, uint64_t tick, uint32_t position, const int16_t *codes)
{
    marked_board *b = context;
    (void)tick;
    (void)codes;
    b->shown[b->instants] = b->lines;
    b->positions[b->instants++] = position;
}

static bool closed(void *context)
{
    (void)context;
    return false;
}

static void request(ta_amplifier *amp, uint8_t type, const uint8_t *payload, size_t size)
{
    uint8_t packet[MARKED_PACKET];
    ta_packet p = {.type = type, .flags = 0x60, .node = 1, .size = size};
    if (size > 0) {
        memcpy(packet + TA_HEADER, payload, size);
    }
    ta_receive(amp, packet, ta_packet_seal(packet, &p), amp->last_tick);
}

static void send_mark(ta_amplifier *amp, uint32_t position, uint8_t code, uint16_t samples)
{
    uint8_t payload[TP_MARK_SIZE];
    tp_mark m = {1, position, code, samples};
    request(amp, TP_MARK, payload, tp_mark_encode(&m, payload, sizeof payload));
}

static void begin_marks(marked_board *b, uint8_t lines)
{
    ta_config config = good_config();
    ta_hal hal = {.context = b, .send = take_report, .put_out = take_instant, .marks = take_lines,
                  .high_voltage = board_high_voltage, .estop_open = closed};
    static const uint8_t hello[] = {1, 0, 1};
    memset(b, 0, sizeof *b);
    config.packet_limit = MARKED_PACKET;
    config.marker_lines = lines;
    config.lateness = 300;
    CHECK(ta_init(&b->amp, &config, &hal));
    request(&b->amp, TP_HELLO, hello, sizeof hello);
}

/* START in 1 ms. */
static void start_marks(marked_board *b, uint32_t position)
{
    uint8_t payload[TP_START_SIZE];
    static const uint8_t arm[] = {1, 0, TP_MODE_PCM, 0x40, 0x1F, 0, 0}; /* 8000 Hz */
    tp_start start = {.session = 1, .position = position, .delay_ms = 1};
    request(&b->amp, TP_ARM, arm, sizeof arm);
    request(&b->amp, TP_START, payload, tp_start_encode(&start, payload, sizeof payload));
}

/* Up to START, from which on instants are counted. */
static void await_start(marked_board *b)
{
    ta_run(&b->amp, b->amp.start_tick - 1);
    b->instants = 0;
}

/* Samples from a position on, at 0 V. */
static void send_samples(ta_amplifier *amp, uint32_t position, uint8_t samples)
{
    uint8_t payload[TP_PCM_SIZE + 2 * 60] = {0};
    uint8_t data[2 * 60] = {0};
    tp_pcm pcm = {.position = position, .session = 1, .channels = 1, .samples = samples, .data = data,
                  .data_size = 2u * samples};
    request(amp, TP_PCM, payload, tp_pcm_encode(&pcm, payload, sizeof payload));
}

/* An amplifier that plays from `position` on, and is to play 60 samples. */
static void play_marks(marked_board *b, uint32_t position)
{
    begin_marks(b, 8);
    start_marks(b, position);
    await_start(b);
    send_samples(&b->amp, position, 60);
}

static void pass(marked_board *b, unsigned instants)
{
    while (instants-- > 0) {
        ta_run(&b->amp, ta_next_instant(&b->amp));
    }
}

/* Checks that a code, and it alone, was on the lines at some instants. */
static void check_shown(const marked_board *b, uint8_t code, size_t first, size_t count)
{
    for (size_t i = 0; i < b->instants; i++) {
        CHECK((b->shown[i] == code) == (i >= first && i < first + count));
    }
}

static marked_board marked;

/* 18.2: with its sample, for as long as it says, over the wrap of positions, and reported. */
static void test_marks_are_shown_with_their_samples(void)
{
    marked_board *b = &marked;
    play_marks(b, UINT32_MAX - 9);
    send_mark(&b->amp, 5, 0x81, 3);
    send_mark(&b->amp, UINT32_MAX - 9, 2, 1); /* with the first sample */
    send_mark(&b->amp, 10, 4, 30);
    send_mark(&b->amp, 20, 8, 1); /* ends the one before */
    pass(b, 60);
    CHECK(b->positions[15] == 5);
    check_shown(b, 2, 0, 1);
    check_shown(b, 0x81, 15, 3);
    check_shown(b, 4, 20, 10);
    check_shown(b, 8, 30, 1);
    CHECK(b->sets == 7 && b->marked == 4 && b->amp.marks.count == 0);
    CHECK(b->reports[0].position == UINT32_MAX - 9 && b->reports[0].code == 2);
    CHECK(b->reports[1].position == 5 && b->reports[1].code == 0x81);
    CHECK(b->reports[3].position == 20 && b->reports[3].code == 8);
    play_marks(b, 0);
    send_mark(&b->amp, 10, 3, 5);
    send_mark(&b->amp, 12, 3, 5); /* the same code goes on, and is reported again */
    pass(b, 30);
    check_shown(b, 3, 10, 7);
    CHECK(b->sets == 2 && b->marked == 2);
}

/* 18.2: which marks are kept, and which are dropped without a count. */
static void test_marks_are_kept_or_dropped(void)
{
    marked_board *b = &marked;
    const ta_counters *counters = &b->amp.counters;
    play_marks(b, 100);
    pass(b, 10);
    CHECK(b->amp.player.position == 110);
    send_mark(&b->amp, 109, 1, 1);
    CHECK(b->amp.marks.count == 0);
    send_mark(&b->amp, 110 + 512, 1, 1);
    CHECK(b->amp.marks.count == 0);
    send_mark(&b->amp, 110 + 511, 1, 1);
    send_mark(&b->amp, 110, 1, 1);
    CHECK(b->amp.marks.count == 2);
    for (uint8_t i = 0; i < 6; i++) {
        send_mark(&b->amp, 120u + i, 1, 1);
    }
    CHECK(b->amp.marks.count == 8);
    send_mark(&b->amp, 130, 1, 1); /* the ninth */
    CHECK(b->amp.marks.count == 8);
    send_mark(&b->amp, 121, 7, 2); /* in the place of another */
    CHECK(b->amp.marks.count == 8);
    pass(b, 30);
    CHECK(b->shown[10] == 1 && b->shown[20] == 1 && b->shown[21] == 7 && b->shown[22] == 1);
    CHECK(b->shown[30] == 0 && b->marked == 7 && b->amp.marks.count == 1);
    CHECK(counters->late_samples == 0 && counters->future_samples == 0 && counters->refused == 0);
}

/* 18.2: before START's time, in WAITING and in STARVED nothing is put out of a position, and nothing is shown. */
static void test_marks_of_samples_that_do_not_play_are_not_shown(void)
{
    marked_board *b = &marked;
    begin_marks(b, 8);
    start_marks(b, 0);
    await_start(b);
    send_mark(&b->amp, 1, 1, 1);
    pass(b, 3); /* WAITING */
    CHECK(b->amp.player.position == 3 && b->amp.marks.count == 0 && b->sets == 0);
    send_samples(&b->amp, 3, 10);
    send_mark(&b->amp, 12, 2, 1);
    send_mark(&b->amp, 13, 4, 1); /* no sample */
    pass(b, 20);
    check_shown(b, 2, 12, 1);
    check_shown(b, 4, 0, 0);
    CHECK(b->amp.player.phase == TP_PHASE_STARVED && b->marked == 1 && b->amp.marks.count == 0);
}

/* The tick of START may be to come: the mark of its position stays. */
static void test_marks_wait_for_the_start(void)
{
    marked_board *b = &marked;
    begin_marks(b, 8);
    start_marks(b, 50);
    send_samples(&b->amp, 50, 60);
    send_mark(&b->amp, 50, 1, 1);
    while (b->amp.start_pending) {
        CHECK(b->sets == 0);
        pass(b, 1);
    }
    CHECK(b->instants > 5 && b->lines == 1 && b->marked == 1);
    pass(b, 5);
    check_shown(b, 1, b->instants - 6, 1);
}

/* 18.2: a recorder sees the whole pulse, also where an e-stop or a stop and a new START come meanwhile; they forget
 * the marks that are kept. */
static void test_a_pulse_is_whole_whatever_comes(void)
{
    marked_board *b = &marked;
    static const uint8_t reason = 1;
    static const uint8_t stop[] = {1, 0, 1};
    play_marks(b, 0);
    send_mark(&b->amp, 5, 1, 40);
    send_mark(&b->amp, 20, 2, 40);
    pass(b, 10);
    request(&b->amp, TP_ESTOP, &reason, 1);
    CHECK(b->amp.state == TP_STATE_ESTOP);
    pass(b, 50);
    check_shown(b, 1, 5, 40);
    check_shown(b, 2, 0, 0);
    CHECK(b->lines == 0 && b->marked == 1);

    play_marks(b, 0);
    send_mark(&b->amp, 5, 1, 40);
    send_mark(&b->amp, 20, 2, 40);
    pass(b, 10);
    request(&b->amp, TP_STOP, stop, sizeof stop);
    pass(b, 1);
    start_marks(b, 15);
    CHECK(b->amp.state == TP_STATE_RUNNING && b->amp.marks.count == 0 && b->lines == 1);
    send_samples(&b->amp, 15, 60);
    pass(b, 50);
    CHECK(b->amp.player.phase == TP_PHASE_PLAYING && b->amp.player.position > 20 + 15);
    check_shown(b, 1, 5, 40);
    check_shown(b, 2, 0, 0);
    CHECK(b->sets == 2);
}

/* 7.1: the mark of a skipped instant is lost, and one that is shown takes no longer. */
static void test_skipped_instants_lose_their_marks(void)
{
    marked_board *b = &marked;
    play_marks(b, 0);
    send_mark(&b->amp, 5, 1, 15);
    send_mark(&b->amp, 12, 2, 1);
    pass(b, 10); /* up to position 9 */
    ta_run(&b->amp, b->amp.next + 7 * 125); /* 10 to 14 are skipped */
    CHECK(b->instants == 13 && b->positions[10] == 15 && b->amp.marks.count == 0);
    pass(b, 10);
    CHECK(b->positions[14] == 19 && b->shown[14] == 1 && b->shown[15] == 0 && b->sets == 2);
    play_marks(b, 0);
    send_mark(&b->amp, 5, 1, 7);
    pass(b, 10);
    ta_run(&b->amp, b->amp.next + 7 * 125); /* its end is among the skipped */
    CHECK(b->positions[10] == 15 && b->shown[9] == 1 && b->shown[10] == 0 && b->sets == 2);
}

/* 5: MARK is of no type without lines, and without a stream ignored. */
static void test_marks_that_are_refused(void)
{
    marked_board *b = &marked;
    begin_marks(b, 0);
    start_marks(b, 0);
    send_mark(&b->amp, 5, 1, 1);
    CHECK(b->refused == TP_NAK_UNKNOWN_TYPE && b->amp.counters.unknown_type == 1);
    begin_marks(b, 3);
    send_mark(&b->amp, 5, 0, 0);
    CHECK(b->refused == TP_NAK_STATE && b->detail == 0 && b->amp.counters.ignored == 1);
    start_marks(b, 0);
    send_mark(&b->amp, 5, 0, 0);
    CHECK(b->refused == TP_NAK_RANGE && b->detail == 2);
    b->detail = 0;
    send_mark(&b->amp, 5, 8, 1);
    CHECK(b->refused == TP_NAK_RANGE && b->detail == 2);
    send_mark(&b->amp, 5, 7, 0);
    CHECK(b->refused == TP_NAK_RANGE && b->detail == 3 && b->amp.counters.refused == 3);
    send_mark(&b->amp, 5, 7, 1);
    CHECK(b->amp.counters.refused == 3 && b->amp.marks.count == 1);
}

static void mask_nothing(void *context)
{
    (void)context;
}

#define REFUSED(field, value)                                                                      \
    do {                                                                                           \
        ta_config bad = good_config();                                                             \
        bad.field = (value);                                                                       \
        CHECK(named(&bad, &hal, #field));                                                          \
    } while (0)

/* What ta_config_fault refuses of the numbers of section 4, by hand; tests/test_protocol_config.py tries
 * thousands against the implementation in Python. */
static void test_configuration(void)
{
    static ta_amplifier amp;
    bool open = false;
    ta_hal hal = board_hal(&open);
    ta_config good = good_config();
    ta_bounds bounds;
    CHECK(ta_config_fault(&good, &hal, &bounds) == NULL && bounds.field == NULL);
    REFUSED(node, 128);
    REFUSED(channels, 0);
    REFUSED(packet_limit, 135);
    REFUSED(rate_min_hz, 999);
    REFUSED(rate_min_hz, 8001);
    REFUSED(rate_max_hz, 1000001);
    REFUSED(tick_hz, 79999);
    REFUSED(full_scale_uv, 0);
    REFUSED(voltage_limit_uv, 0);
    REFUSED(voltage_limit_uv, 100000001);
    REFUSED(fade_limit_us, 20001);
    REFUSED(slew_limit_v_per_s, 5103); /* enough at 2500 and at 8000 Hz */
    REFUSED(formats, 0xFFF0);
    REFUSED(marker_lines, 9);
    good.fifo_samples = 511;
    CHECK(named(&good, &hal, "fifo_samples"));
    CHECK(ta_config_fault(&good, &hal, &bounds) != NULL && bounds.value == 511 && bounds.least == 512);
    good = good_config();
    good.rate_max_hz = good.rate_min_hz; /* it plays one rate */
    good.slew_limit_v_per_s = 5006;
    CHECK(ta_init(&amp, &good, &hal) && amp.state == TP_STATE_IDLE && amp.counters.trips == 0);
    open = true;
    CHECK(ta_init(&amp, &good, &hal) && amp.state == TP_STATE_ESTOP && amp.counters.trips == 1);
    CHECK(amp.estop_reason == TP_ESTOP_REASON_INPUT && !amp.high_voltage);
}

/* The rules that are more than a range: functions of the board, 6.3, 10, 16 and the name. */
static void test_configuration_of_the_board(void)
{
    bool open = false;
    ta_hal hal = board_hal(&open);
    ta_config good = good_config();
    hal.estop_open = NULL;
    good.full_scale_uv = 60000001;
    good.voltage_limit_uv = 1000000; /* it is the full scale that counts */
    CHECK(named(&good, &hal, "estop_open"));
    good.full_scale_uv = 60000000;
    CHECK(ta_config_fault(&good, &hal, NULL) == NULL);
    hal.currents = board_currents;
    CHECK(named(&good, &hal, "sense_range_ua"));
    good.sense_range_ua = 1;
    CHECK(ta_config_fault(&good, &hal, NULL) == NULL);
    good.formats = 8;
    CHECK(named(&good, &hal, "carriers"));
    good.carriers = 1;
    CHECK(ta_config_fault(&good, &hal, NULL) == NULL);
    memcpy(good.name, "a\xC3\xA4", 4);
    CHECK(ta_config_fault(&good, &hal, NULL) == NULL);
    good.name[15] = 'b';
    CHECK(named(&good, &hal, "name"));
    memset(good.name, 'c', sizeof good.name);
    CHECK(ta_config_fault(&good, &hal, NULL) == NULL);
    good.name[15] = (char)0xC3;
    CHECK(named(&good, &hal, "name"));
    good = good_config();
    hal = board_hal(&open);
    hal.send = NULL;
    CHECK(named(&good, &hal, "send"));
    hal = board_hal(&open);
    hal.put_out = NULL;
    CHECK(named(&good, &hal, "put_out"));
    hal = board_hal(&open);
    hal.high_voltage = NULL;
    CHECK(named(&good, &hal, "high_voltage"));
    hal = board_hal(&open);
    hal.mask = mask_nothing;
    CHECK(named(&good, &hal, "unmask"));
    hal = board_hal(&open);
    hal.marks = NULL;
    CHECK(ta_config_fault(&good, &hal, NULL) == NULL);
    good.marker_lines = 1;
    CHECK(named(&good, &hal, "marks"));
}

/* Replies that wait for an I2C host: as many as there is room for, to the last byte, in order, at
 * whatever place of the ring they begin. */
static void test_replies(void)
{
    static ta_replies replies;
    uint8_t packet[TA_REPLIES];
    uint8_t got[TA_REPLIES];
    for (size_t i = 0; i < sizeof packet; i++) {
        packet[i] = (uint8_t)(7 * i);
    }
    for (size_t begin = 0; begin < TA_REPLIES; begin++) {
        size_t waiting = 0;
        size_t room = TA_REPLIES;
        replies.head = begin;
        while (ta_replies_push(&replies, packet + waiting, 98)) {
            waiting++;
            room -= 100;
            CHECK(replies.used == TA_REPLIES - room);
        }
        CHECK(waiting == TA_REPLIES / 100 && room >= 2);
        CHECK(!ta_replies_push(&replies, packet, room - 1)); /* one byte too many */
        CHECK(ta_replies_push(&replies, packet, room - 2));
        CHECK(replies.used == TA_REPLIES && !ta_replies_push(&replies, packet, 0));
        for (size_t k = 0; k < waiting; k++) {
            CHECK(ta_i2c_read(&replies, got, sizeof got) == 100 && got[0] == 98 && got[1] == 0);
            CHECK(memcmp(got + 2, packet + k, 98) == 0);
        }
        CHECK(ta_i2c_read(&replies, got, sizeof got) == room);
        CHECK(memcmp(got + 2, packet, room - 2) == 0 && !ta_replies_waiting(&replies));
        CHECK(ta_i2c_read(&replies, got, sizeof got) == 2 && got[0] == 0 && got[1] == 0);
    }
}

/* As many channels as there is room for. The drive steps by 100 at the third of four samples, and the
 * current of channel k is k: the step is 0 samples before that one, and 1 before the last. */
static void test_correlator(void)
{
    static ta_correlator c;
    static int16_t codes[TA_CHANNELS];
    static int16_t currents[TA_CHANNELS];
    uint8_t entry[TA_ENTRY];
    ta_correlator_start(&c, TA_CHANNELS, 0);
    CHECK(ta_correlator_add(&c, currents) == TA_WINDOW_LACKS); /* none is under way */
    ta_correlator_open(&c, 7, 4, 2500);
    for (int16_t n = 0; n < 4; n++) {
        for (size_t k = 0; k < TA_CHANNELS; k++) {
            codes[k] = n < 2 ? 0 : 100;
            currents[k] = (int16_t)k;
        }
        ta_correlator_played(&c, codes);
        ta_correlator_open(&c, 9, 2, 1); /* one is */
        CHECK(ta_correlator_add(&c, currents) == (n < 3 ? TA_WINDOW_LACKS : TA_WINDOW_COMPLETE));
    }
    const ta_window *window = ta_correlator_window(&c);
    CHECK(window->position == 7 && window->samples == 4 && window->range_ua == 2500);
    for (size_t k = 0; k < TA_CHANNELS; k++) {
        ta_correlator_entry(&window->sums[k], entry);
        CHECK(entry[0] == 0 && entry[1] == 0);
        for (size_t lag = 0; lag < TP_LAGS; lag++) {
            CHECK(tp_get_le(entry, sizeof entry, 4 + 2 * lag, 2) == (lag < 2 ? 100 * k : 0));
        }
    }
    ta_correlator_open(&c, 11, 1, 2500);
    CHECK(ta_correlator_add(&c, currents) == TA_WINDOW_LOST);
    CHECK(ta_correlator_window(&c) == window && window->position == 7);
    ta_correlator_sent(&c);
    ta_correlator_open(&c, 12, 1, 2500);
    CHECK(ta_correlator_add(&c, currents) == TA_WINDOW_COMPLETE);
    CHECK(ta_correlator_window(&c)->position == 12);
}

int main(void)
{
    static const size_t rooms[] = {8, 32, 64};
    test_arithmetic();
    test_crc();
    test_packet();
    test_cobs();
    test_cobs_errors();
    for (size_t i = 0; i < 3; i++) {
        for (size_t size = 8; size <= 255; size++) {
            test_fragments(size, rooms[i]);
        }
    }
    test_reordered();
    test_fd_lengths();
    test_sine();
    test_amplitudes();
    test_envelope();
    test_queue();
    test_samples();
    test_bfp8();
    test_player();
    test_skipped_samples();
    test_skipped_frames();
    test_correlator();
    test_configuration();
    test_configuration_of_the_board();
    test_replies();
    test_input_is_read_at_instants();
    test_skipping_keeps_the_clock();
    test_skipping_ends_the_window();
    test_marks_are_shown_with_their_samples();
    test_marks_are_kept_or_dropped();
    test_marks_of_samples_that_do_not_play_are_not_shown();
    test_marks_wait_for_the_start();
    test_a_pulse_is_whole_whatever_comes();
    test_skipped_instants_lose_their_marks();
    test_marks_that_are_refused();
    return failures == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
}
