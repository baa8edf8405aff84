/* Division of packets into fragments for CAN, CAN FD and SMBus (section 3.2). */
#ifndef TACTILE_FRAGMENT_H
#define TACTILE_FRAGMENT_H

#include "tactile_core.h"

/* Bits of the first byte of each fragment. */
#define TA_FRAGMENT_START 0x80u
#define TA_FRAGMENT_END 0x40u
#define TA_FRAGMENT_TOGGLE 0x20u
#define TA_FRAGMENT_ID 0x1Fu

/* A packet that is being divided; set packet, size and id, and the rest to 0. */
typedef struct {
    const uint8_t *packet;
    size_t size;
    size_t sent;
    uint8_t id; /* transfer id, 0 ... 31 */
    uint8_t toggle;
    bool started;
} ta_cutter;

/* Writes the next fragment, of at most `room` (8, 32 or 64) bytes. Returns its size, or 0 after the
 * last one. */
size_t ta_cut(ta_cutter *cutter, uint8_t *out, size_t room);

/* Returns the least length of a CAN FD frame that holds `size` bytes, at most 64. */
size_t ta_can_fd_length(size_t size);

typedef struct {
    bool used;
    uint32_t identifier;
    uint8_t id;
    uint8_t toggle;  /* toggle that the next fragment must have */
    uint32_t number; /* number of the transfer, in the order of their starts */
    uint64_t start;  /* tick of the start */
    size_t length;   /* length by the first fragment */
    size_t size;     /* bytes that have arrived */
    uint8_t bytes[TA_PACKET_MAX];
} ta_transfer;

typedef struct {
    uint32_t tick_hz;
    size_t limit;      /* longest packet */
    uint32_t *dropped; /* the counter fragments_dropped */
    uint32_t number;
    ta_transfer transfers[TA_TRANSFERS];
} ta_reassembly;

void ta_reassembly_init(ta_reassembly *r, size_t limit, uint32_t tick_hz, uint32_t *dropped);

/* Drops transfers that began 20 ms ago or more. */
void ta_reassembly_expire(ta_reassembly *r, uint64_t now);

/* Adds a fragment. `padded` says that it may have zeros after its end, as CAN FD frames do.
 * Returns the transfer that it completed, which is valid until the next call, or NULL. */
const ta_transfer *ta_reassembly_feed(ta_reassembly *r, uint32_t identifier,
                                      const uint8_t *fragment, size_t size, bool padded,
                                      uint64_t now);

#endif
