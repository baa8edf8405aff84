/* Arbitrary bytes on the serial link; and COBS must give back what it was given. */
#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static bool nowhere(void *context, const uint8_t *bytes, size_t size)
{
    (void)context;
    HOLDS(bytes[size - 1] == 0);
    return true;
}

static void round_trip(ta_cobs *cobs, const uint8_t *data, size_t size)
{
    static uint8_t coded[TA_COBS_MAX(TA_PACKET_MAX) + 1u];
    ta_cobs_event event;
    size_t piece = size > 0 ? 1u + data[0] : 1u; /* fed at a time */
    size_t taken = 0;
    if (size > TA_PACKET_MAX) {
        return;
    }
    size_t length = ta_cobs_encode(data, size, coded);
    HOLDS(length <= TA_COBS_MAX(size));
    ta_cobs_init(cobs, TA_PACKET_MAX);
    for (size_t i = 0; i < length; i++) {
        HOLDS(coded[i] != 0);
    }
    coded[length++] = 0;
    do {
        size_t left = length - taken;
        taken += ta_cobs_feed(cobs, coded + taken, left < piece ? left : piece, &event);
        HOLDS(event == (taken < length ? TA_COBS_MORE : TA_COBS_FRAME));
    } while (taken < length);
    HOLDS(cobs->frame == size && (size == 0 || memcmp(cobs->bytes, data, size) == 0));
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static fuzz_board board;
    static ta_serial link;
    fuzz_power_up(&board, 136);
    ta_serial_init(&link, &board.amp, nowhere, NULL);
    for (size_t i = 0; i < size; i++) {
        ta_serial_feed(&link, data + i, 1, 10u * i);
    }
    HOLDS(ta_serial_send(&link, data, size < TA_REPLY_MAX ? size : TA_REPLY_MAX));
    round_trip(&link.cobs, data, size);
    return 0;
}
