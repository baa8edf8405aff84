/* Arbitrary CAN frames: two bytes of identifier, one of length and one of time, then data. And a packet
 * that is cut must come together again. */
#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static ta_can *other; /* where frames that are sent go to, as from a host */

static bool cross(void *context, const ta_can_frame *frame)
{
    const ta_transfer **whole = context;
    const ta_transfer *t = ta_reassembly_feed(&other->reassembly, frame->id, frame->data,
                                              frame->size, frame->size > 8u, 0);
    HOLDS(ta_can_fd_length(frame->size) == frame->size);
    *whole = t != NULL ? t : *whole;
    return true;
}

static void round_trip(ta_can *link, const uint8_t *data, size_t size)
{
    const ta_transfer *whole = NULL;
    if (size < TA_OVERHEAD || size > 136 || data[0] == TP_PULSE) {
        return;
    }
    link->context = &whole;
    HOLDS(ta_can_send(link, data, size));
    HOLDS(whole != NULL && whole->size == size && memcmp(whole->bytes, data, size) == 0);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static fuzz_board board;
    static ta_can link;
    static ta_can receiver;
    uint64_t now = 0;
    size_t at = 0;
    fuzz_power_up(&board, 136);
    board.arming = false;
    ta_can_init(&link, &board.amp, size % 2 != 0, size % 4 > 1, cross, NULL);
    ta_can_init(&receiver, &board.amp, true, size % 4 > 1, cross, NULL);
    other = &receiver;
    while (size - at >= 4) {
        ta_can_frame frame = {0};
        frame.extended = (data[at + 1] & 0x80) != 0;
        frame.id = (data[at] | (uint32_t)(data[at + 1] & 7u) << 8) |
                   (frame.extended ? TP_CAN_PREFIX : 0u);
        frame.size = data[at + 2] % 65u;
        now += 20u * data[at + 3];
        at += 4;
        if (frame.size > size - at) {
            frame.size = (uint8_t)(size - at);
        }
        memcpy(frame.data, data + at, frame.size);
        at += frame.size;
        ta_can_feed(&link, &frame, now);
    }
    round_trip(&link, data, size);
    return 0;
}
