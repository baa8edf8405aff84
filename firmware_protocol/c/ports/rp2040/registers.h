/* Registers of the RP2040 (Raspberry Pi, RP2040 data sheet), as far as the port needs them. They were checked against
 * the headers hardware/regs/ and hardware/structs/ of the pico-sdk (src/rp2040), and the order of the start in main.c
 * against its pll.c, xosc.c and watchdog.c. */
#ifndef REGISTERS_H
#define REGISTERS_H

#include "pl011.h"
#include "pl022.h"

/* 2.1.2: writing at these offsets sets or clears bits of a register */
#define SET(register) (*(&(register) + 0x2000u / 4u))
#define CLEAR(register) (*(&(register) + 0x3000u / 4u))

/* 2.14: resets of the peripherals */
#define RESETS_RESET PORT_REGISTER(0x4000C000u)
#define RESETS_DONE PORT_REGISTER(0x4000C008u)
#define RESETS_IO_BANK0 (1u << 5)
#define RESETS_PADS_BANK0 (1u << 8)
#define RESETS_PLL_SYS (1u << 12)
#define RESETS_SPI0 (1u << 16)
#define RESETS_TIMER (1u << 21)
#define RESETS_UART0 (1u << 22)

/* 2.13: which parts the watchdog resets */
#define PSM_WDSEL PORT_REGISTER(0x40010008u)
#define PSM_ALL_BUT_OSCILLATORS 0x0001FFFCu

/* 2.15, 2.16 and 2.18: clocks, crystal oscillator and PLL */
#define CLK_REF_CTRL PORT_REGISTER(0x40008030u)
#define CLK_REF_SELECTED PORT_REGISTER(0x40008038u)
#define CLK_REF_XOSC 2u
#define CLK_SYS_CTRL PORT_REGISTER(0x4000803Cu)
#define CLK_SYS_SELECTED PORT_REGISTER(0x40008044u)
#define CLK_SYS_PLL 1u /* the auxiliary source, which is the PLL after reset */
#define CLK_PERI_CTRL PORT_REGISTER(0x40008048u)
#define CLK_PERI_ENABLE (1u << 11) /* by the clock of the system */
#define XOSC_CTRL PORT_REGISTER(0x40024000u)
#define XOSC_ENABLE 0x00FABAA0u /* 1 ... 15 MHz */
#define XOSC_STATUS PORT_REGISTER(0x40024004u)
#define XOSC_STABLE (1u << 31)
#define XOSC_STARTUP PORT_REGISTER(0x4002400Cu)
#define PLL_CS PORT_REGISTER(0x40028000u)
#define PLL_CS_LOCK (1u << 31)
#define PLL_PWR PORT_REGISTER(0x40028004u)
#define PLL_PWR_PD (1u << 0)
#define PLL_PWR_POSTDIVPD (1u << 3)
#define PLL_PWR_VCOPD (1u << 5)
#define PLL_FBDIV PORT_REGISTER(0x40028008u)
#define PLL_PRIM PORT_REGISTER(0x4002800Cu)
#define PLL_PRIM_DIVIDERS(first, second) ((first) << 16 | (second) << 12)

/* 2.19: pins */
#define GPIO_CTRL(pin) PORT_REGISTER(0x40014004u + 8u * (pin))
#define GPIO_SPI 1u
#define GPIO_UART 2u
#define GPIO_SIO 5u
#define GPIO_INTR(pin) PORT_REGISTER(0x400140F0u + (pin) / 8u * 4u)
#define GPIO_INTE(pin) PORT_REGISTER(0x40014100u + (pin) / 8u * 4u)
#define GPIO_RISES(pin) (8u << (pin) % 8u * 4u)
#define PAD(pin) PORT_REGISTER(0x4001C004u + 4u * (pin))
#define PAD_INPUT_PULL_UP 0x4Au /* with a Schmitt trigger */

/* 2.3.1: levels of the pins */
#define SIO_IN PORT_REGISTER(0xD0000004u)
#define SIO_OUT PORT_REGISTER(0xD0000010u)
#define SIO_OUT_SET PORT_REGISTER(0xD0000014u)
#define SIO_OUT_CLEAR PORT_REGISTER(0xD0000018u)
#define SIO_OUT_TOGGLE PORT_REGISTER(0xD000001Cu)
#define SIO_OE_SET PORT_REGISTER(0xD0000024u)

/* 4.6: the timer, which counts microseconds */
#define TIMER_ALARM(n) PORT_REGISTER(0x40054010u + 4u * (n))
#define TIMER_RAW PORT_REGISTER(0x40054028u)
#define TIMER_INTR PORT_REGISTER(0x40054034u)
#define TIMER_INTE PORT_REGISTER(0x40054038u)

/* 4.7: watchdog, whose clock is that of the timer as well */
#define WATCHDOG_CTRL PORT_REGISTER(0x40058000u)
#define WATCHDOG_ENABLE (1u << 30)
#define WATCHDOG_LOAD PORT_REGISTER(0x40058004u)
#define WATCHDOG_TICK PORT_REGISTER(0x4005802Cu)
#define WATCHDOG_TICK_ENABLE (1u << 9)

#define UART0 ((pl011 *)0x40034000u)
#define SPI0 ((pl022 *)0x4003C000u)

/* 2.3.2: numbers of interrupts */
#define TIMER_0_IRQ 0u
#define TIMER_1_IRQ 1u
#define IO_BANK0_IRQ 13u
#define UART0_IRQ 20u

#endif
