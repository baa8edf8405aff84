/* The numbers of messages: every size and offset near the end of a payload, which packet.c takes as given. */
#include "proof.h"

#define LONGEST 12u

/* Both end where their arrays end. */
static void both(size_t length, size_t at, size_t size)
{
    uint8_t in[LONGEST];
    uint8_t out[8];
    ANY(in);
    uint64_t value = tp_get_le(in + (LONGEST - length), length, at, size);
    tp_put_le(out + (sizeof out - size), value, size);
}

int main(void)
{
    for (size_t length = 0; length <= LONGEST; length++) {
        for (size_t at = 0; at <= length; at++) {
            for (size_t size = 0; size <= 8; size++) {
                both(length, at, size);
            }
        }
    }
    return 0;
}
