/* Rings between the interrupt of the UART and the rest. Each has one writer and one reader, and an index that
 * only that one changes. */
#include "port.h"

#define STAMP 8u /* bytes of a tick */

TA_ASSERT(received, PORT_RX != 0 && (PORT_RX & (PORT_RX - 1u)) == 0);
TA_ASSERT(sent, PORT_TX != 0 && (PORT_TX & (PORT_TX - 1u)) == 0);

static volatile uint8_t rx[PORT_RX]; /* bytes, and after each delimiter its tick */
static volatile uint32_t rx_written;
static volatile uint32_t rx_read;

static volatile uint8_t tx[PORT_TX];
static volatile uint32_t tx_written;
static volatile uint32_t tx_read;

/* What finds no room is lost, and its frame fails the check of COBS or CRC-32. */
void port_received(uint8_t byte)
{
    uint32_t at = rx_written;
    uint32_t size = byte == 0 ? 1u + STAMP : 1u;
    if (PORT_RX - (at - rx_read) < size) {
        return;
    }
    rx[at++ % PORT_RX] = byte;
    if (byte == 0) {
        uint64_t tick = port_ticks();
        for (unsigned k = 0; k < STAMP; k++) {
            rx[at++ % PORT_RX] = (uint8_t)(tick >> 8u * k);
        }
    }
    rx_written = at;
}

size_t port_take(uint8_t *bytes, size_t size, uint64_t *tick)
{
    uint32_t at = rx_read;
    size_t taken = 0;
    *tick = port_ticks();
    while (taken < size && at != rx_written) {
        uint8_t byte = rx[at++ % PORT_RX];
        bytes[taken++] = byte;
        if (byte == 0) {
            *tick = 0;
            for (unsigned k = 0; k < STAMP; k++) {
                *tick |= (uint64_t)rx[at++ % PORT_RX] << 8u * k;
            }
            break;
        }
    }
    rx_read = at;
    return taken;
}

bool port_write(void *context, const uint8_t *bytes, size_t size)
{
    uint32_t at = tx_written;
    (void)context;
    if (PORT_TX - (at - tx_read) < size) {
        return false;
    }
    while (size-- > 0) {
        tx[at++ % PORT_TX] = *bytes++;
    }
    tx_written = at;
    port_pend(board.uart_irq); /* it sends the first byte, and its own interrupts the others */
    return true;
}

int port_next_byte(void)
{
    uint32_t at = tx_read;
    if (at == tx_written) {
        return -1;
    }
    int byte = tx[at % PORT_TX];
    tx_read = at + 1u;
    return byte;
}
