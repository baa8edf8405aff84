/* Two CMSDK UARTs; see the header. Registers: Arm DDI 0479, "Cortex-M System Design Kit", 4.3. */
#include "uart.h"

#include <stdbool.h>

#include "machine.h"

#define RING 8192u /* bytes; two of the longest packets, so that one is read while the next arrives */
#define INTERRUPTS_ENABLED (*(volatile uint32_t *)0xE000E100u)

#define STATE_TX_FULL 1u
#define STATE_RX_FULL 2u
#define CONTROL_TX 1u
#define CONTROL_RX 2u
#define CONTROL_RX_INTERRUPT 8u
#define RX_INTERRUPT 2u
#define DIVIDER_LEAST 16u /* the fastest rate; QEMU heeds no rate */

typedef struct {
    uint32_t data;
    uint32_t state;
    uint32_t control;
    uint32_t interrupts; /* written: cleared */
    uint32_t divider;
} registers;

static volatile registers *const uarts[] = {(volatile registers *)0x40004000u, (volatile registers *)0x40005000u};
static const uint32_t interrupts[] = {0, 2};

/* `written` and `read` count all bytes; the interrupt changes `written` only, the program `read` only. */
typedef struct {
    volatile uint32_t written;
    volatile uint32_t read;
    volatile uint8_t bytes[RING];
} ring;

static ring rings[2];

static void received(uart_line line)
{
    ring *r = &rings[line];
    uarts[line]->interrupts = RX_INTERRUPT;
    while ((uarts[line]->state & STATE_RX_FULL) != 0) {
        if (r->written - r->read == RING) {
            machine_print("bytes have come for which the ring has no room\n");
            machine_exit(false);
        }
        r->bytes[r->written % RING] = (uint8_t)uarts[line]->data;
        r->written++;
    }
}

void uart0_received(void)
{
    received(UART0);
}

void uart1_received(void)
{
    received(UART1);
}

void uart_begin(void)
{
    for (size_t i = 0; i < sizeof rings / sizeof rings[0]; i++) {
        uarts[i]->divider = DIVIDER_LEAST;
        uarts[i]->control = CONTROL_TX | CONTROL_RX | CONTROL_RX_INTERRUPT;
        INTERRUPTS_ENABLED = 1u << interrupts[i];
    }
}

/* Sleeps until there is a byte. An interrupt that comes between the look and WFI ends WFI all the same, since it
 * stays pending while interrupts are masked. */
static void await(const ring *r)
{
    __asm__ volatile("cpsid i" ::: "memory");
    while (r->written == r->read) {
        __asm__ volatile("wfi\n\tcpsie i\n\tisb\n\tcpsid i" ::: "memory");
    }
    __asm__ volatile("cpsie i" ::: "memory");
}

void uart_read(uart_line line, uint8_t *bytes, size_t size)
{
    ring *r = &rings[line];
    for (size_t i = 0; i < size; i++) {
        await(r);
        bytes[i] = r->bytes[r->read % RING];
        r->read++;
    }
}

void uart_write(uart_line line, const uint8_t *bytes, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        while ((uarts[line]->state & STATE_TX_FULL) != 0) {
        }
        uarts[line]->data = bytes[i];
    }
}
