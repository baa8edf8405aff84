/* Packets and COBS; see the header. */
#include "tactile_packet.h"

/* Remainders of the 16 half-bytes for the reflected polynomial 0xEDB88320. Eight look-ups for four bytes
 * take as long as the four look-ups of the usual table of 1 KiB, with its loads and turns of the loop. */
static const uint32_t crc_table[16] = {
    0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u,
    0x4DB26158u, 0x5005713Cu, 0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu,
    0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu,
};

/* The next half-byte of what was added to `crc`; a function would not be inlined with -Os. */
#define CRC_STEP(crc) ((crc) = (crc) >> 4 ^ crc_table[(crc) & 15u])

uint32_t ta_crc32(const uint8_t *bytes, size_t size)
{
    uint32_t crc = 0xFFFFFFFFu;
    /*@ loop invariant size <= \at(size, Pre) && bytes == \at(bytes, Pre) + (\at(size, Pre) - size);
        loop assigns size, bytes, crc;
        loop variant size; */
    for (; size >= 4; size -= 4, bytes += 4) {
        crc ^= (uint32_t)bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16 |
               (uint32_t)bytes[3] << 24;
        CRC_STEP(crc);
        CRC_STEP(crc);
        CRC_STEP(crc);
        CRC_STEP(crc);
        CRC_STEP(crc);
        CRC_STEP(crc);
        CRC_STEP(crc);
        CRC_STEP(crc);
    }
    /*@ loop invariant size <= \at(size, Pre) && bytes == \at(bytes, Pre) + (\at(size, Pre) - size);
        loop assigns size, bytes, crc;
        loop variant size; */
    for (; size > 0; size--) {
        crc ^= *bytes++;
        CRC_STEP(crc);
        CRC_STEP(crc);
    }
    return ~crc;
}

bool ta_packet_decode(ta_packet *packet, const uint8_t *bytes, size_t size)
{
    if (size < TA_OVERHEAD) {
        return false;
    }
    size_t end = size - 4u;
    if (ta_crc32(bytes, end) != (uint32_t)tp_get_le(bytes, size, end, 4)) {
        return false;
    }
    packet->type = bytes[0];
    packet->flags = bytes[1];
    packet->node = bytes[2];
    packet->seq = bytes[3];
    packet->payload = bytes + TA_HEADER;
    packet->size = end - TA_HEADER;
    return true;
}

size_t ta_packet_seal(uint8_t *bytes, const ta_packet *packet)
{
    size_t end = TA_HEADER + packet->size;
    bytes[0] = packet->type;
    bytes[1] = packet->flags;
    bytes[2] = packet->node;
    bytes[3] = packet->seq;
    tp_put_le(bytes + end, ta_crc32(bytes, end), 4);
    return end + 4u;
}

size_t ta_cobs_encode(const uint8_t *in, size_t size, uint8_t *out)
{
    size_t block = 0; /* where the code of the block goes */
    size_t to = 1;
    uint8_t code = 1;
    /*@ loop invariant i <= size && to == block + code && 1 <= code && (i < size ==> code <= 254);
        loop invariant 0 <= 254 * (to - 1 - i) <= i + 1 - code;
        loop assigns i, block, to, code, out[0 .. TA_COBS_MAX(size) - 1];
        loop variant size - i; */
    for (size_t i = 0; i < size; i++) {
        if (in[i] != 0) {
            out[to++] = in[i];
            code++;
        }
        if (in[i] == 0 || (code == 0xFFu && i + 1u < size)) {
            out[block] = code;
            block = to++;
            code = 1;
        }
    }
    out[block] = code;
    return to;
}

static void cobs_restart(ta_cobs *cobs)
{
    cobs->size = 0;
    cobs->left = 0;
    cobs->begun = false;
    cobs->zero = false;
    cobs->skip = false;
}

void ta_cobs_init(ta_cobs *cobs, size_t limit)
{
    cobs->limit = limit;
    cobs->frame = 0;
    cobs_restart(cobs);
}

static ta_cobs_event cobs_delimiter(ta_cobs *cobs)
{
    ta_cobs_event event = cobs->left > 0 ? TA_COBS_MALFORMED : TA_COBS_FRAME;
    if (!cobs->begun || cobs->skip) {
        event = TA_COBS_MORE;
    }
    cobs->frame = cobs->size;
    cobs_restart(cobs);
    return event;
}

/* Begins a block, of which `code` - 1 bytes follow; the block before it stands for a zero at its end. */
static void cobs_code(ta_cobs *cobs, uint8_t code)
{
    if (cobs->zero && cobs->size >= cobs->limit) {
        cobs->skip = true;
        return;
    }
    if (cobs->zero) {
        cobs->bytes[cobs->size++] = 0;
    }
    cobs->begun = true;
    cobs->left = (uint8_t)(code - 1u);
    cobs->zero = code != 0xFFu;
}

/* Keeps what `size` bytes, at least one, hold of the block, up to a delimiter; returns their number. */
static size_t cobs_block(ta_cobs *cobs, const uint8_t *bytes, size_t size)
{
    size_t room = cobs->limit - cobs->size;
    size_t most = size < cobs->left ? size : cobs->left;
    if (room == 0) {
        cobs->skip = true;
        return 0;
    }
    most = most < room ? most : room;
    uint8_t *to = cobs->bytes + cobs->size;
    size_t count = 0;
    /*@ loop invariant count < most;
        loop assigns count, to[0 .. most - 1];
        loop variant most - count; */
    do {
        uint8_t byte = bytes[count];
        if (byte == 0) {
            break;
        }
        to[count++] = byte;
    } while (count < most);
    cobs->size += count;
    cobs->left = (uint8_t)(cobs->left - count);
    return count;
}

size_t ta_cobs_feed(ta_cobs *cobs, const uint8_t *bytes, size_t size, ta_cobs_event *event)
{
    size_t at = 0;
    *event = TA_COBS_MORE;
    /*@ loop invariant at <= size;
        loop invariant ta_cobs_holds(cobs);
        loop invariant cobs->limit == \at(cobs->limit, Pre);
        loop invariant TA_COBS_MORE <= *event <= TA_COBS_OVERSIZED;
        loop invariant *event == TA_COBS_FRAME ==> cobs->frame <= cobs->limit;
        loop invariant *event == TA_COBS_MORE || at > 0 || (*event == TA_COBS_OVERSIZED && cobs->skip);
        loop assigns at, *event, *cobs;
        loop variant size - at + (*event == TA_COBS_MORE ? 1 : 0); */
    while (at < size && *event == TA_COBS_MORE) {
        bool skipped = cobs->skip;
        if (bytes[at] == 0) {
            *event = cobs_delimiter(cobs);
            at++;
        } else if (skipped) {
            at++;
        } else if (cobs->left > 0) {
            at += cobs_block(cobs, bytes + at, size - at);
        } else {
            cobs_code(cobs, bytes[at]);
            at++;
        }
        if (cobs->skip && !skipped) {
            *event = TA_COBS_OVERSIZED;
        }
    }
    return at;
}
