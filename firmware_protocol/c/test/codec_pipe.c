/* The codec as a filter, for tests that compare it with another.
 *
 * Records come on stdin, each a byte that says what to do, the size of what follows as u32, and that.
 * Each is answered on stdout by a size as u32 and as many bytes; NONE in place of the size says that
 * it was refused. All numbers are little-endian.
 *
 *   P packet                               the packet of its message, decoded and encoded again
 *   C bytes                                COBS of them
 *   S limit u16, bytes                     packets in a stream, each after its size as u16, then the
 *                                          times it was malformed and oversized, u32 each
 *   F room u8, id u8, packet               fragments, each after its size as u8
 *   R limit u16, then per fragment identifier u16, microseconds u32, size u8, bytes
 *                                          packets, each after its size as u16, then those dropped, u32
 *   D format u8, channels u8, samples u8, data    codes i16
 *   E format u8, channels u8, samples u8, codes   data
 */
#include <stdio.h>
#include <stdlib.h>

#include "../tactile_fragment.h"
#include "../tactile_packet.h"
#include "../tactile_samples.h"

#define NONE 0xFFFFFFFFu
#define MOST (1u << 20)

static uint8_t in[MOST];
static uint8_t out[MOST];

/* Decodes the payload as the message and writes it behind a packet's header; NONE if it is none. */
#define AGAIN(NAME, name)                                                                          \
    case TP_##NAME: {                                                                              \
        tp_##name message;                                                                         \
        if (!tp_##name##_decode(&message, packet->payload, packet->size)) {                        \
            return NONE;                                                                           \
        }                                                                                          \
        return (uint32_t)tp_##name##_encode(&message, out + TA_HEADER, MOST - TA_HEADER);          \
    }

static uint32_t payload_again(const ta_packet *packet)
{
    switch (packet->type) {
        AGAIN(HELLO, hello)
        AGAIN(TIME, time)
        AGAIN(SYNC, sync)
        AGAIN(START, start)
        AGAIN(STOP, stop)
        AGAIN(ARM, arm)
        AGAIN(DISARM, disarm)
        AGAIN(ESTOP, estop)
        AGAIN(CLEAR_FAULT, clear_fault)
        AGAIN(HEARTBEAT, heartbeat)
        AGAIN(LIMITS, limits)
        AGAIN(GET, get)
        AGAIN(SET, set)
        AGAIN(IDENTIFY, identify)
        AGAIN(POLL, poll)
        AGAIN(PCM, pcm)
        AGAIN(CARRIERS, carriers)
        AGAIN(SPECTRUM, spectrum)
        AGAIN(ACK, ack)
        AGAIN(NAK, nak)
        AGAIN(CAPS, caps)
        AGAIN(TIME_REPLY, time_reply)
        AGAIN(VALUE, value)
        AGAIN(PULSE, pulse)
        AGAIN(STATUS, status)
        AGAIN(SENSE, sense)
        AGAIN(LOG, log)
        AGAIN(CORRELATION, correlation)
        AGAIN(GUARD, guard)
        AGAIN(GUARDED, guarded)
        AGAIN(MARK, mark)
        AGAIN(MARKED, marked)
    default:
        return NONE;
    }
}

static uint32_t packet_again(size_t size)
{
    ta_packet packet;
    if (!ta_packet_decode(&packet, in, size)) {
        return NONE;
    }
    uint32_t payload = payload_again(&packet);
    if (payload == NONE) {
        return NONE;
    }
    packet.size = payload;
    return (uint32_t)ta_packet_seal(out, &packet);
}

/* A packet behind what is in `out` already, if its CRC-32 is right. */
static size_t add_packet(size_t at, const uint8_t *bytes, size_t size)
{
    ta_packet packet;
    if (!ta_packet_decode(&packet, bytes, size)) {
        return at;
    }
    tp_put_le(out + at, size, 2);
    memcpy(out + at + 2, bytes, size);
    return at + 2 + size;
}

static uint32_t stream(size_t size)
{
    static ta_cobs cobs;
    uint32_t malformed = 0;
    uint32_t oversized = 0;
    size_t at = 0;
    ta_cobs_init(&cobs, (size_t)tp_get_le(in, size, 0, 2));
    for (size_t i = 2; i < size;) {
        ta_cobs_event event;
        i += ta_cobs_feed(&cobs, in + i, size - i, &event);
        switch (event) {
        case TA_COBS_FRAME:
            malformed += cobs.frame < TA_OVERHEAD;
            at = add_packet(at, cobs.bytes, cobs.frame);
            break;
        case TA_COBS_MALFORMED:
            malformed++;
            break;
        case TA_COBS_OVERSIZED:
            oversized++;
            break;
        default:
            break;
        }
    }
    tp_put_le(out + at, malformed, 4);
    tp_put_le(out + at + 4, oversized, 4);
    return (uint32_t)at + 8u;
}

static uint32_t cut(size_t size)
{
    ta_cutter cutter = {0};
    size_t at = 0;
    cutter.packet = in + 2;
    cutter.size = size - 2;
    cutter.id = in[1];
    for (;;) {
        size_t part = ta_cut(&cutter, out + at + 1, in[0]);
        if (part == 0) {
            return (uint32_t)at;
        }
        out[at] = (uint8_t)part;
        at += part + 1;
    }
}

static uint32_t reassemble(size_t size)
{
    static ta_reassembly reassembly;
    uint32_t dropped = 0;
    size_t at = 0;
    size_t next = 2;
    ta_reassembly_init(&reassembly, (size_t)tp_get_le(in, size, 0, 2), 1000000, &dropped);
    while (next + 7 <= size) {
        uint32_t identifier = (uint32_t)tp_get_le(in, size, next, 2);
        uint64_t now = tp_get_le(in, size, next + 2, 4);
        size_t length = in[next + 6];
        const ta_transfer *t =
            ta_reassembly_feed(&reassembly, identifier, in + next + 7, length, length > 8, now);
        if (t != NULL) {
            at = add_packet(at, t->bytes, t->size);
        }
        next += 7 + length;
    }
    tp_put_le(out + at, dropped, 4);
    return (uint32_t)at + 4u;
}

static uint32_t decode_samples(void)
{
    ta_samples samples = {in[0], in[1], in[2], in + 3};
    int16_t codes[255];
    size_t at = 0;
    for (uint8_t s = 0; samples.channels > 0 && s < samples.samples; s++) {
        ta_samples_row(&samples, s, codes);
        for (uint8_t c = 0; c < samples.channels; c++) {
            tp_put_le(out + at, (uint64_t)(uint16_t)codes[c], 2);
            at += 2;
        }
    }
    return (uint32_t)at;
}

static uint32_t encode_samples(void)
{
    static int16_t codes[255 * 255];
    size_t count = (size_t)in[1] * in[2];
    for (size_t i = 0; i < count; i++) {
        uint16_t code = (uint16_t)tp_get_le(in, MOST, 3 + 2 * i, 2);
        codes[i] = (int16_t)(code < 0x8000u ? code : (int32_t)code - 0x10000);
    }
    ta_samples_encode(codes, in[0], in[1], in[2], out);
    return (uint32_t)ta_samples_size(in[0], in[1], in[2]);
}

static uint32_t answer(int what, size_t size)
{
    switch (what) {
    case 'P':
        return packet_again(size);
    case 'C':
        return (uint32_t)ta_cobs_encode(in, size, out);
    case 'S':
        return stream(size);
    case 'F':
        return cut(size);
    case 'R':
        return reassemble(size);
    case 'D':
        return decode_samples();
    case 'E':
        return encode_samples();
    default:
        return NONE;
    }
}

int main(void)
{
    uint8_t head[5];
    while (fread(head, 1, sizeof head, stdin) == sizeof head) {
        size_t size = (size_t)tp_get_le(head, sizeof head, 1, 4);
        if (size > MOST || fread(in, 1, size, stdin) != size) {
            return EXIT_FAILURE;
        }
        uint32_t given = answer(head[0], size);
        tp_put_le(head, given, 4);
        fwrite(head, 1, 4, stdout);
        fwrite(out, 1, given == NONE ? 0 : given, stdout);
    }
    return EXIT_SUCCESS;
}
