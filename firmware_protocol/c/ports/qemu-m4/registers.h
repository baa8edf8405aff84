/* Registers of the AN386 on the MPS2 (Arm, DAI 0386 and DDI 0479 of the CMSDK), as far as the port needs them. */
#ifndef REGISTERS_H
#define REGISTERS_H

#include "pl022.h"
#include "port.h"

/* CMSDK timers, which count down and begin anew */
typedef struct {
    volatile uint32_t ctrl;
    volatile uint32_t value;
    volatile uint32_t reload;
    volatile uint32_t intclear;
} timer;

#define TIMER0 ((timer *)0x40000000u)
#define TIMER1 ((timer *)0x40001000u)
#define TIMER_ENABLE (1u << 0)
#define TIMER_INTERRUPT (1u << 3)

/* The dual timer, of which one half counts down through 32 bits */
#define DUAL_VALUE PORT_REGISTER(0x40002004u)
#define DUAL_CONTROL PORT_REGISTER(0x40002008u)
#define DUAL_32_BITS (1u << 1)
#define DUAL_ENABLE (1u << 7)

/* CMSDK UART, without a FIFO */
#define UART_DATA PORT_REGISTER(0x40004000u)
#define UART_STATE PORT_REGISTER(0x40004004u)
#define UART_STATE_TX_FULL (1u << 0)
#define UART_STATE_RX_FULL (1u << 1)
#define UART_CTRL PORT_REGISTER(0x40004008u)
#define UART_CTRL_ENABLE 0x0Fu /* both directions and their interrupts */
#define UART_INTCLEAR PORT_REGISTER(0x4000400Cu)
#define UART_INT_ALL 0x0Fu
#define UART_DIVIDER PORT_REGISTER(0x40004010u)

/* CMSDK watchdog: an NMI at its first timeout, and a reset at the second */
#define WATCHDOG_LOAD PORT_REGISTER(0x40008000u)
#define WATCHDOG_CTRL PORT_REGISTER(0x40008008u)
#define WATCHDOG_INTCLEAR PORT_REGISTER(0x4000800Cu)
#define WATCHDOG_ENABLE 3u

/* CMSDK GPIO: levels, directions, and pins 0 ... 7, or 8 ... 15, through a mask in the address */
#define GPIO_DATA PORT_REGISTER(0x40010000u)
#define GPIO_OUTPUTS PORT_REGISTER(0x40010010u)
#define GPIO_MASKED(pins) PORT_REGISTER(0x40010400u + 4u * (pins))
#define GPIO_MASKED_HIGH(pins) PORT_REGISTER(0x40010800u + 4u * (pins))

#define SPI0 ((pl022 *)0x40020000u)

/* Numbers of interrupts */
#define UART_RX_IRQ 0u
#define UART_TX_IRQ 1u
#define TIMER0_IRQ 8u
#define TIMER1_IRQ 9u

#endif
