/* Registers of the nRF51822 (Nordic Semiconductor, nRF51 Series Reference Manual 3.0), as far as the port needs
 * them. An event is 1 once it has happened, and firmware writes 0. */
#ifndef REGISTERS_H
#define REGISTERS_H

#include "port.h"

/* 13: clock */
#define CLOCK_START_CRYSTAL PORT_REGISTER(0x40000000u)

/* 14: pins */
#define GPIO_OUT_SET PORT_REGISTER(0x50000508u)
#define GPIO_OUT_CLEAR PORT_REGISTER(0x5000050Cu)
#define GPIO_IN PORT_REGISTER(0x50000510u)
#define GPIO_OUTPUTS_SET PORT_REGISTER(0x50000518u)
#define GPIO_PIN(pin) PORT_REGISTER(0x50000700u + 4u * (pin))
#define GPIO_PIN_PULL_UP (3u << 2)

/* 18: timers, TIMER0 of 32 bits and TIMER1 of 16 */
#define TIMER0 0x40008000u
#define TIMER1 0x40009000u
#define TIMER_START(timer) PORT_REGISTER((timer) + 0x000u)
#define TIMER_STOP(timer) PORT_REGISTER((timer) + 0x004u)
#define TIMER_CLEAR(timer) PORT_REGISTER((timer) + 0x00Cu)
#define TIMER_CAPTURE(timer, n) PORT_REGISTER((timer) + 0x040u + 4u * (n))
#define TIMER_COMPARE(timer, n) PORT_REGISTER((timer) + 0x140u + 4u * (n))
#define TIMER_SHORTS(timer) PORT_REGISTER((timer) + 0x200u)
#define TIMER_STOPS(n) (1u << (8u + (n)))
#define TIMER_INTENSET(timer) PORT_REGISTER((timer) + 0x304u)
#define TIMER_INTERRUPT(n) (1u << (16u + (n)))
#define TIMER_BITMODE(timer) PORT_REGISTER((timer) + 0x508u)
#define TIMER_16_BITS 0u
#define TIMER_32_BITS 3u
#define TIMER_PRESCALER(timer) PORT_REGISTER((timer) + 0x510u)
#define TIMER_CC(timer, n) PORT_REGISTER((timer) + 0x540u + 4u * (n))

/* 24: watchdog, by its own clock of 32 kHz */
#define WDT_START PORT_REGISTER(0x40010000u)
#define WDT_LOAD PORT_REGISTER(0x40010504u)
#define WDT_RELOAD PORT_REGISTER(0x40010600u)
#define WDT_RELOAD_KEY 0x6E524635u

/* 29: UART */
#define UART_START_RX PORT_REGISTER(0x40002000u)
#define UART_START_TX PORT_REGISTER(0x40002008u)
#define UART_RXDRDY PORT_REGISTER(0x40002108u)
#define UART_TXDRDY PORT_REGISTER(0x4000211Cu)
#define UART_INTENSET PORT_REGISTER(0x40002304u)
#define UART_INTERRUPTS (1u << 2 | 1u << 7)
#define UART_ENABLE PORT_REGISTER(0x40002500u)
#define UART_ENABLED 4u
#define UART_PIN_TX PORT_REGISTER(0x4000250Cu)
#define UART_PIN_RX PORT_REGISTER(0x40002514u)
#define UART_RXD PORT_REGISTER(0x40002518u)
#define UART_TXD PORT_REGISTER(0x4000251Cu)
#define UART_BAUDRATE PORT_REGISTER(0x40002524u)
#define UART_1_MBIT_PER_S 0x10000000u

/* Numbers of interrupts */
#define UART_IRQ 2u
#define TIMER0_IRQ 8u
#define TIMER1_IRQ 9u

#endif
