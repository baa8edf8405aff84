/* UART of several parts (Arm PrimeCell PL011, DDI 0183). */
#ifndef PL011_H
#define PL011_H

#include "port.h"

typedef struct {
    volatile uint32_t dr;
    volatile uint32_t rsr;
    uint32_t reserved[4];
    volatile uint32_t fr;
    uint32_t reserved_1c;
    volatile uint32_t ilpr;
    volatile uint32_t ibrd;
    volatile uint32_t fbrd;
    volatile uint32_t lcr_h;
    volatile uint32_t cr;
    volatile uint32_t ifls;
    volatile uint32_t imsc;
    volatile uint32_t ris;
    volatile uint32_t mis;
    volatile uint32_t icr;
} pl011;

#define PL011_FR_RXFE (1u << 4)
#define PL011_FR_TXFF (1u << 5)
#define PL011_LCR_FIFO (1u << 4)
#define PL011_LCR_8_BITS (3u << 5)
#define PL011_CR_UARTEN (1u << 0)
#define PL011_CR_TXE (1u << 8)
#define PL011_CR_RXE (1u << 9)
#define PL011_INT_RX (1u << 4)
#define PL011_INT_TX (1u << 5)
#define PL011_INT_RT (1u << 6) /* bytes wait, and no more come for 32 bits: it stamps the end of a packet */
#define PL011_INT_ALL 0x7FFu

/* Starts with 8N1; the divider has 6 bits after the point. */
static inline void pl011_begin(pl011 *uart, uint32_t clock_hz, uint32_t bit_rate)
{
    uint32_t divider = (4u * clock_hz + bit_rate / 2u) / bit_rate;
    uart->cr = 0;
    uart->ibrd = divider >> 6;
    uart->fbrd = divider & 0x3Fu;
    uart->lcr_h = PL011_LCR_8_BITS | PL011_LCR_FIFO;
    uart->ifls = 0; /* interrupts at an eighth of the FIFO: of the bytes that came and of those to send */
    uart->imsc = PL011_INT_RX | PL011_INT_TX | PL011_INT_RT;
    uart->cr = PL011_CR_UARTEN | PL011_CR_TXE | PL011_CR_RXE;
}

/* The interrupt of the UART. */
static inline void pl011_interrupt(pl011 *uart)
{
    uart->icr = PL011_INT_ALL;
    while ((uart->fr & PL011_FR_RXFE) == 0) {
        port_received((uint8_t)uart->dr);
    }
    while ((uart->fr & PL011_FR_TXFF) == 0) {
        int byte = port_next_byte();
        if (byte < 0) {
            break;
        }
        uart->dr = (uint32_t)byte;
    }
}

#endif
