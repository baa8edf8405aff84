/* Registers of the LM3S6965 (Texas Instruments, SPMS294), as far as the port needs them. */
#ifndef REGISTERS_H
#define REGISTERS_H

#include "pl011.h"
#include "pl022.h"

/* 5.5: system control */
#define RCGC0 PORT_REGISTER(0x400FE100u)
#define RCGC0_WDT (1u << 3)
#define RCGC1 PORT_REGISTER(0x400FE104u)
#define RCGC1_UART0 (1u << 0)
#define RCGC1_SSI0 (1u << 4)
#define RCGC1_TIMERS (3u << 16) /* 0 and 1 */
#define RCGC2 PORT_REGISTER(0x400FE108u)
#define RCGC2_GPIOA (1u << 0)
#define RCGC2_GPIOB (1u << 1)
#define RCGC2_GPIOC (1u << 2)
#define RCGC2_GPIOD (1u << 3)

/* 8.5: GPIO; the address has the mask of the pins that are written or read */
#define GPIOA 0x40004000u
#define GPIOB 0x40005000u
#define GPIOC 0x40006000u
#define GPIOD 0x40007000u
#define GPIO_DATA(port, pins) PORT_REGISTER((port) + ((pins) << 2))
#define GPIO_DIR(port) PORT_REGISTER((port) + 0x400u)
#define GPIO_AFSEL(port) PORT_REGISTER((port) + 0x420u)
#define GPIO_PUR(port) PORT_REGISTER((port) + 0x510u)
#define GPIO_DEN(port) PORT_REGISTER((port) + 0x51Cu)

/* 9.6: timers; a half of a timer alone has 16 bits, both together 32 */
#define TIMER0 0x40030000u
#define TIMER1 0x40031000u
#define TIMER_CFG(timer) PORT_REGISTER((timer) + 0x00u)
#define TIMER_MODE(timer) PORT_REGISTER((timer) + 0x04u)
#define TIMER_CTL(timer) PORT_REGISTER((timer) + 0x0Cu)
#define TIMER_IMR(timer) PORT_REGISTER((timer) + 0x18u)
#define TIMER_ICR(timer) PORT_REGISTER((timer) + 0x24u)
#define TIMER_LOAD(timer) PORT_REGISTER((timer) + 0x28u)
#define TIMER_ONE_SHOT 1u
#define TIMER_ENABLE 1u
#define TIMER_TIMEOUT 1u

/* 10.4: watchdog, which resets the part at its second timeout */
#define WDT_LOAD PORT_REGISTER(0x40000000u)
#define WDT_CTL PORT_REGISTER(0x40000008u)
#define WDT_ICR PORT_REGISTER(0x4000000Cu)
#define WDT_CTL_ENABLE 3u

/* 3.1: the timer of the processor, which counts down with 24 bits */
#define SYSTICK_CTRL PORT_REGISTER(0xE000E010u)
#define SYSTICK_RELOAD PORT_REGISTER(0xE000E014u)
#define SYSTICK_CURRENT PORT_REGISTER(0xE000E018u)
#define SYSTICK_ENABLE 5u /* by the clock of the processor */
#define SYSTICK_MASK 0xFFFFFFu

#define UART0 ((pl011 *)0x4000C000u)
#define SSI0 ((pl022 *)0x40008000u)

/* 2.4: numbers of interrupts */
#define UART0_IRQ 5u
#define TIMER0_IRQ 19u
#define TIMER1_IRQ 21u

#endif
