/* Registers of the STM32G474 (ST, RM0440), as far as the port needs them. Addresses, bits and numbers of interrupts
 * were checked against stm32g474xx.h of ST's cmsis-device-g4; the clock, the SPI and the FIFO of the USART against
 * stm32g4xx_hal_rcc.c, stm32g4xx_hal_spi.c and stm32g4xx_hal_uart_ex.c of its stm32g4xx-hal-driver; the alternate
 * functions, in main.c, against stm32g474r(b-c-e)tx-pinctrl.dtsi of Zephyr's hal_stm32. */
#ifndef REGISTERS_H
#define REGISTERS_H

#include "port.h"

/* Flash */
#define FLASH_ACR PORT_REGISTER(0x40022000u)
#define FLASH_ACR_LATENCY 0x0Fu
#define FLASH_ACR_LATENCY_4 4u /* wait states: up to 150 MHz without boost */
#define FLASH_ACR_PRFTEN (1u << 8)

/* Clocks */
#define RCC_CR PORT_REGISTER(0x40021000u)
#define RCC_CR_PLLON (1u << 24)
#define RCC_CR_PLLRDY (1u << 25)
#define RCC_CFGR PORT_REGISTER(0x40021008u)
#define RCC_CFGR_SW_PLL 3u
#define RCC_CFGR_SWS (3u << 2)
#define RCC_CFGR_SWS_PLL (3u << 2)
#define RCC_CFGR_HPRE_2 (8u << 4)
#define RCC_PLLCFGR PORT_REGISTER(0x4002100Cu)
#define RCC_PLLCFGR_HSI 2u
#define RCC_PLLCFGR_M(m) (((m) - 1u) << 4)
#define RCC_PLLCFGR_N(n) ((n) << 8)
#define RCC_PLLCFGR_REN (1u << 24) /* with R = 2 */
#define RCC_AHB2ENR PORT_REGISTER(0x4002104Cu)
#define RCC_AHB2ENR_GPIOA (1u << 0)
#define RCC_AHB2ENR_GPIOB (1u << 1)
#define RCC_AHB2ENR_GPIOC (1u << 2)
#define RCC_APB1ENR1 PORT_REGISTER(0x40021058u)
#define RCC_APB1ENR1_TIM2 (1u << 0)
#define RCC_APB1ENR1_TIM6 (1u << 4)
#define RCC_APB1ENR1_USART2 (1u << 17)
#define RCC_APB2ENR PORT_REGISTER(0x40021060u)
#define RCC_APB2ENR_SYSCFG (1u << 0)
#define RCC_APB2ENR_SPI1 (1u << 12)

/* GPIO */
typedef struct {
    volatile uint32_t moder;
    volatile uint32_t otyper;
    volatile uint32_t ospeedr;
    volatile uint32_t pupdr;
    volatile uint32_t idr;
    volatile uint32_t odr;
    volatile uint32_t bsrr; /* sets pins by bits 0 ... 15, clears them by bits 16 ... 31 */
    volatile uint32_t lckr;
    volatile uint32_t afr[2];
} gpio;

#define GPIOA ((gpio *)0x48000000u)
#define GPIOB ((gpio *)0x48000400u)
#define GPIOC ((gpio *)0x48000800u)
#define GPIO_INPUT 0u
#define GPIO_OUTPUT 1u
#define GPIO_ALTERNATE 2u
#define GPIO_PULL_UP 1u
#define GPIO_FAST 2u

/* Interrupts of pins */
#define SYSCFG_EXTICR1 PORT_REGISTER(0x40010008u)
#define SYSCFG_EXTICR1_PB1 (1u << 4)
#define EXTI_IMR1 PORT_REGISTER(0x40010400u)
#define EXTI_RTSR1 PORT_REGISTER(0x40010408u)
#define EXTI_PR1 PORT_REGISTER(0x40010414u)

/* Timers, TIM2 of 32 bits and the basic TIM6 of 16 */
typedef struct {
    volatile uint32_t cr1;
    volatile uint32_t cr2;
    volatile uint32_t smcr;
    volatile uint32_t dier;
    volatile uint32_t sr;
    volatile uint32_t egr;
    volatile uint32_t ccmr1;
    volatile uint32_t ccmr2;
    volatile uint32_t ccer;
    volatile uint32_t cnt;
    volatile uint32_t psc;
    volatile uint32_t arr;
    volatile uint32_t rcr;
    volatile uint32_t ccr1;
} timer;

#define TIM2 ((timer *)0x40000000u)
#define TIM6 ((timer *)0x40001000u)
#define TIM_CR1_CEN (1u << 0)
#define TIM_CR1_URS (1u << 2) /* EGR sets no flag */
#define TIM_CR1_OPM (1u << 3)
#define TIM_DIER_UIE (1u << 0)
#define TIM_DIER_CC1IE (1u << 1)
#define TIM_SR_CC1IF (1u << 1)
#define TIM_EGR_UG (1u << 0)
#define TIM_CCMR1_ACTIVE_ON_MATCH (1u << 4)
#define TIM_CCMR1_INACTIVE (4u << 4)
#define TIM_CCMR1_ACTIVE (5u << 4)
#define TIM_CCER_CC1E (1u << 0)
#define TIM_CCER_CC1P (1u << 1) /* active is low */

/* USART */
typedef struct {
    volatile uint32_t cr1;
    volatile uint32_t cr2;
    volatile uint32_t cr3;
    volatile uint32_t brr;
    volatile uint32_t gtpr;
    volatile uint32_t rtor;
    volatile uint32_t rqr;
    volatile uint32_t isr;
    volatile uint32_t icr;
    volatile uint32_t rdr;
    volatile uint32_t tdr;
} usart;

#define USART2 ((usart *)0x40004400u)
#define USART_CR1_UE (1u << 0)
#define USART_CR1_RE (1u << 2)
#define USART_CR1_TE (1u << 3)
#define USART_CR1_RXFNEIE (1u << 5)
#define USART_CR1_TXFNFIE (1u << 7)
#define USART_CR1_FIFOEN (1u << 29)
#define USART_ISR_RXFNE (1u << 5)
#define USART_ISR_TXFNF (1u << 7)
#define USART_ICR_ERRORS 0x0Fu /* parity, framing, noise, overrun */

/* SPI; the data register is accessed by 16 bits where a frame has 9 ... 16 */
#define SPI1_CR1 PORT_REGISTER(0x40013000u)
#define SPI1_CR2 PORT_REGISTER(0x40013004u)
#define SPI1_SR PORT_REGISTER(0x40013008u)
#define SPI1_DR (*(volatile uint16_t *)0x4001300Cu)
#define SPI_CR1_CPHA (1u << 0)
#define SPI_CR1_MSTR (1u << 2)
#define SPI_CR1_BR_4 (1u << 3) /* the clock / 4 */
#define SPI_CR1_SPE (1u << 6)
#define SPI_CR1_SSI (1u << 8)
#define SPI_CR1_SSM (1u << 9)
#define SPI_CR1_SEND_ONLY (3u << 14)
#define SPI_CR2_12_BITS (11u << 8)
#define SPI_SR_TXE (1u << 1)
#define SPI_SR_BSY (1u << 7)
#define SPI_SR_FTLVL (3u << 11) /* frames in the FIFO */

/* Independent watchdog, by its own clock of 32 kHz */
#define IWDG_KR PORT_REGISTER(0x40003000u)
#define IWDG_KR_START 0xCCCCu
#define IWDG_KR_ACCESS 0x5555u
#define IWDG_KR_FEED 0xAAAAu
#define IWDG_PR PORT_REGISTER(0x40003004u)
#define IWDG_PR_8 1u
#define IWDG_RLR PORT_REGISTER(0x40003008u)

/* Numbers of interrupts */
#define EXTI1_IRQ 7u
#define TIM2_IRQ 28u
#define USART2_IRQ 38u
#define TIM6_IRQ 54u

#endif
