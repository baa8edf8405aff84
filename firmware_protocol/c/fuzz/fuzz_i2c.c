/* Arbitrary raw and SMBus transfers, written and read: a byte of kind, a byte of length, data. */
#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static fuzz_board board;
    static ta_smbus link;
    uint8_t out[256];
    size_t at = 0;
    fuzz_power_up(&board, 255);
    ta_smbus_init(&link, &board.amp, &board.replies);
    while (size - at >= 2) {
        uint8_t kind = data[at];
        size_t length = data[at + 1];
        at += 2;
        if (kind % 5 < 3 && length > size - at) {
            length = size - at;
        }
        switch (kind % 5) {
        case 0:
            ta_i2c_write(&board.amp, data + at, length, 100u * at);
            at += length;
            break;
        case 1:
            ta_smbus_write(&link, data + at, length, 100u * at);
            at += length;
            break;
        case 2: /* as it would wait for a host */
            (void)ta_replies_push(&board.replies, data + at, length);
            at += length;
            break;
        case 3:
            HOLDS(ta_i2c_read(&board.replies, out, length) <= length);
            break;
        default:
            length = ta_smbus_read(&link, out);
            HOLDS(length >= 1 && length <= TA_SMBUS_BLOCK);
            break;
        }
    }
    while (ta_replies_waiting(&board.replies)) {
        HOLDS(ta_i2c_read(&board.replies, out, sizeof out) >= 2);
        (void)ta_smbus_read(&link, out);
    }
    return 0;
}
