/* The packet of section 2 and its coding for byte streams, section 3.1: CRC-32 and COBS. */
#ifndef TACTILE_PACKET_H
#define TACTILE_PACKET_H

#include "tactile_core.h"

typedef struct {
    uint8_t type;
    uint8_t flags;
    uint8_t node;
    uint8_t seq;
    const uint8_t *payload; /* points into the bytes that were decoded */
    size_t size;            /* bytes of the payload */
} ta_packet;

/* Computes the CRC-32 of zlib's crc32(); "123456789" gives 0xCBF43926. */
uint32_t ta_crc32(const uint8_t *bytes, size_t size);

/* Decodes a packet. Returns false if it is shorter than 8 bytes or its CRC-32 is wrong. */
bool ta_packet_decode(ta_packet *packet, const uint8_t *bytes, size_t size);

/* Puts header and CRC-32 around a payload of packet->size bytes, which is at bytes + TA_HEADER already.
 * Returns the size of the packet, size + TA_OVERHEAD. */
size_t ta_packet_seal(uint8_t *bytes, const ta_packet *packet);

/* Largest number of bytes that COBS makes of `size`, without the delimiter. */
#define TA_COBS_MAX(size) ((size) + (size) / 254u + 1u)

/* Encodes `size` bytes into `out`, which has room for TA_COBS_MAX(size). Returns the encoded size. */
size_t ta_cobs_encode(const uint8_t *in, size_t size, uint8_t *out);

typedef enum {
    TA_COBS_MORE,      /* nothing yet */
    TA_COBS_FRAME,     /* `frame` bytes are in `bytes`, until more is fed */
    TA_COBS_MALFORMED, /* the delimiter came within a block */
    TA_COBS_OVERSIZED  /* returned once; what follows is dropped up to the delimiter */
} ta_cobs_event;

typedef struct {
    uint8_t bytes[TA_PACKET_MAX];
    size_t limit; /* longest packet, at most TA_PACKET_MAX */
    size_t frame; /* size of the latest complete frame */
    size_t size;  /* bytes decoded so far */
    uint8_t left; /* bytes of the block that are still to come */
    bool begun;   /* a byte has come since the last delimiter */
    bool zero;    /* the block stands for a zero at its end, if another follows */
    bool skip;    /* too long: wait for the delimiter */
} ta_cobs;

/* Holds between any two calls; proof/packet.c relies on it. */
/*@ predicate ta_cobs_holds(ta_cobs *c) =
      c->size <= c->limit <= TA_PACKET_MAX && c->left <= 254 && (c->begun == 0 || c->begun == 1) &&
      (c->zero == 0 || c->zero == 1) && (c->skip == 0 || c->skip == 1); */

void ta_cobs_init(ta_cobs *cobs, size_t limit);

/* Decodes bytes up to the first event, which may come with the last of them or not at all. Returns how many
 * it took: the rest is to be fed next. The decoded size alone decides what is too long: a frame that decodes
 * to at most `limit` bytes has at most TA_COBS_MAX(limit) encoded ones. */
size_t ta_cobs_feed(ta_cobs *cobs, const uint8_t *bytes, size_t size, ta_cobs_event *event);

#endif
