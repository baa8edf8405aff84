/* What a board with the serial link keeps in RAM, and what it calls, for `make size`. */
#include "../../tactile_link.h"

void loop(const ta_config *config, const ta_hal *hal, const uint8_t *bytes, size_t size, uint64_t tick);
void interrupt(uint64_t tick);
bool send(void *context, const uint8_t *packet, size_t size);
bool uart_write(void *context, const uint8_t *bytes, size_t size);

ta_amplifier amplifier;
ta_serial serial;

bool send(void *context, const uint8_t *packet, size_t size)
{
    (void)context;
    return ta_serial_send(&serial, packet, size);
}

void interrupt(uint64_t tick)
{
    ta_run(&amplifier, tick);
}

void loop(const ta_config *config, const ta_hal *hal, const uint8_t *bytes, size_t size, uint64_t tick)
{
    if (!ta_init(&amplifier, config, hal)) {
        return;
    }
    ta_serial_init(&serial, &amplifier, uart_write, NULL);
    for (;;) {
        ta_serial_feed(&serial, bytes, size, tick);
        ta_serve(&amplifier);
    }
}
