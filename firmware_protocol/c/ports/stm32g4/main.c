/* The amplifier on an STM32G474 (Cortex-M4 at 150 MHz), for example on a NUCLEO-G474RE. It has been compiled, and
 * has not run on a board.
 *
 *     PA0           LDAC of three AD5672R, 24 channels of 12 bits: TIM2 itself pulls it low at the tick
 *     PA2, PA3      UART, 8N1, 1 Mbit/s (on the NUCLEO the virtual port of the ST-LINK)
 *     PA5, PA7      clock and data of the DACs
 *     PB0           enable of the high-voltage supply; a resistor of 10 k holds it low at reset
 *     PB1           e-stop input: the normally closed contact to ground
 *     PB10 ... 12   SYNC of each AD5672R, low while it is loaded
 *     PC0 ... 7     marker lines 0 ... 7, some microseconds after LDAC; a resistor holds each low at reset
 *     NRST          RESET of the DACs: the part pulls it low at each reset, also that of its watchdog, and the
 *                   outputs go to 0 V without firmware (duty 9)
 *
 * The contact is in series with PB0 and the supply as well (6.3), which no firmware can replace.
 */
#include "registers.h"

#include "ad5672r.h"

#define CLOCK_HZ 150000000u
#define TICK_HZ 10000000u
#define LEAD (TICK_HZ / 2000u) /* 0.5 ms from an instant to its latch: no masked section is as long */
#define BIT_RATE 1000000u
#define DACS (TA_CHANNELS / AD5672R_CHANNELS)

#define HIGH_VOLTAGE_PIN 0u
#define ESTOP_PIN 1u
#define SYNC_PIN(dac) (10u + (dac))
#define MARKER_LINES 8u

TA_ASSERT(channels_of_dacs, DACS * AD5672R_CHANNELS == TA_CHANNELS);

/* The properties of the board, which CAPS tells to the host. TA_CHANNELS, TA_FIFO and others are set in the
 * Makefile, since they are sizes of arrays. */
static const ta_config config = {
    .node = 1,
    .channels = TA_CHANNELS,
    .carriers = TA_CARRIERS,
    .holds = true, /* the DAC holds each sample */
    .formats = 0x0F,
    .packet_limit = TA_PACKET_MAX,
    .fifo_samples = TA_FIFO,
    .marker_lines = MARKER_LINES,
    .lateness = LEAD,
    .tick_hz = TICK_HZ,
    .rate_min_hz = 2500,
    .rate_max_hz = 8000,
    .full_scale_uv = 100000000, /* of code 32767, behind the amplifier of the DAC's ±1.25 V */
    .voltage_limit_uv = 100000000,
    .slew_limit_v_per_s = 700000,
    .fade_limit_us = 20000,
    .firmware = 0x00010000,
    .name = "stm32g4",
};

const port_board board = {
    .counter_mask = UINT32_MAX,
    .lead = LEAD,
    .uart_irq = USART2_IRQ,
    .latch_irq = TIM2_IRQ,
    .run_irq = TIM6_IRQ,
};

/* Pins */

static void set_mode(gpio *port, unsigned pin, uint32_t mode)
{
    port->moder = (port->moder & ~(3u << 2u * pin)) | mode << 2u * pin;
}

static void set_alternate(gpio *port, unsigned pin, uint32_t function)
{
    volatile uint32_t *afr = &port->afr[pin / 8u];
    unsigned shift = 4u * (pin % 8u);
    *afr = (*afr & ~(0xFu << shift)) | function << shift;
    port->ospeedr |= GPIO_FAST << 2u * pin;
    set_mode(port, pin, GPIO_ALTERNATE);
}

static void set_output(gpio *port, unsigned pin, bool level)
{
    port->bsrr = level ? 1u << pin : 1u << (pin + 16u);
    set_mode(port, pin, GPIO_OUTPUT);
}

/* Outputs */

/* At reset all these pins are analog: the resistor holds the supply off, and NRST has put the DACs to 0 V. After a
 * fault the supply goes first, and then the DACs by the reset that follows. */
void board_outputs_off(void)
{
    RCC_AHB2ENR |= RCC_AHB2ENR_GPIOB;
    (void)RCC_AHB2ENR; /* the clock of a port takes two cycles to start */
    set_output(GPIOB, HIGH_VOLTAGE_PIN, false);
}

static void spi_write(uint32_t word)
{
    SPI1_DR = (uint16_t)(word >> 12);
    while ((SPI1_SR & SPI_SR_TXE) == 0) {
    }
    SPI1_DR = (uint16_t)(word & 0xFFFu);
    while ((SPI1_SR & (SPI_SR_FTLVL | SPI_SR_BSY)) != 0) { /* TXE is set while a frame still waits */
    }
}

/* Takes about 1 us for each channel. */
void board_load(const int16_t *codes)
{
    for (size_t c = 0; c < TA_CHANNELS; c++) {
        unsigned pin = SYNC_PIN(c / AD5672R_CHANNELS);
        GPIOB->bsrr = 1u << (pin + 16u);
        spi_write(ad5672r_word(c, codes[c]));
        GPIOB->bsrr = 1u << pin;
    }
}

/* Lets LDAC go up again. If the time had passed before the timer was set, this is what latches. */
void board_latch(void)
{
    TIM2->ccmr1 = TIM_CCMR1_ACTIVE;
    TIM2->ccmr1 = TIM_CCMR1_ACTIVE; /* for 20 ns at least: a write takes two cycles of 6.7 ns */
    TIM2->ccmr1 = TIM_CCMR1_INACTIVE;
}

/* One write changes all of them: where it both sets and clears a pin, it sets it. */
void board_mark(uint8_t lines)
{
    GPIOC->bsrr = 0xFFu << 16 | lines;
}

void board_high_voltage(bool on)
{
    GPIOB->bsrr = on ? 1u << HIGH_VOLTAGE_PIN : 1u << (HIGH_VOLTAGE_PIN + 16u);
}

/* The closed contact pulls the pin down; a broken wire leaves it up, and stops as well. */
bool board_estop_open(void)
{
    return (GPIOB->idr >> ESTOP_PIN & 1u) != 0;
}

/* Time */

uint32_t board_counter(void)
{
    return TIM2->cnt;
}

/* The timer pulls LDAC low at the tick and interrupts; where the tick has passed, port_latch notices. */
void board_latch_at(uint64_t tick)
{
    TIM2->ccr1 = (uint32_t)tick;
    TIM2->ccmr1 = TIM_CCMR1_ACTIVE_ON_MATCH;
}

/* TIM6 has 16 bits, 6.5 ms: it may interrupt too early, and is set again. */
void board_run_at(uint64_t tick)
{
    uint64_t now = port_ticks();
    uint64_t left = tick > now ? tick - now : 1u;
    TIM6->cr1 = TIM_CR1_URS | TIM_CR1_OPM;
    TIM6->arr = left < UINT16_MAX ? (uint32_t)left : UINT16_MAX;
    TIM6->egr = TIM_EGR_UG;
    TIM6->cr1 = TIM_CR1_URS | TIM_CR1_OPM | TIM_CR1_CEN;
}

void board_feed_watchdog(void)
{
    IWDG_KR = IWDG_KR_FEED;
}

/* Interrupts */

/* Each byte interrupts, so that the time of a delimiter is true to 1 us; the FIFO of 8 bytes is for the times at
 * which this comes late. */
static void uart(void)
{
    USART2->icr = USART_ICR_ERRORS; /* what was lost fails the check of COBS or CRC-32 */
    while ((USART2->isr & USART_ISR_RXFNE) != 0) {
        port_received((uint8_t)USART2->rdr);
    }
    while ((USART2->isr & USART_ISR_TXFNF) != 0) {
        int byte = port_next_byte();
        if (byte < 0) {
            USART2->cr1 &= ~USART_CR1_TXFNFIE;
            return;
        }
        USART2->tdr = (uint32_t)byte;
    }
    USART2->cr1 |= USART_CR1_TXFNFIE;
}

static void latch(void)
{
    TIM2->sr = ~TIM_SR_CC1IF;
    port_latch();
}

static void run(void)
{
    TIM6->sr = 0;
    port_run();
}

static void estop(void)
{
    EXTI_PR1 = 1u << ESTOP_PIN;
    port_estop_moved();
}

PORT_INTERRUPTS = {
    [EXTI1_IRQ] = estop, [TIM2_IRQ] = latch, [USART2_IRQ] = uart, [TIM6_IRQ] = run};

/* Start */

/* 150 MHz from the internal 16 MHz, the most that needs no boost of the core's voltage. The clock of the bus is
 * halved for the moment of the step. A board with a crystal takes that instead. */
static void begin_clock(void)
{
    FLASH_ACR = (FLASH_ACR & ~FLASH_ACR_LATENCY) | FLASH_ACR_LATENCY_4 | FLASH_ACR_PRFTEN;
    while ((FLASH_ACR & FLASH_ACR_LATENCY) != FLASH_ACR_LATENCY_4) {
    }
    RCC_PLLCFGR = RCC_PLLCFGR_HSI | RCC_PLLCFGR_M(4u) | RCC_PLLCFGR_N(75u) | RCC_PLLCFGR_REN;
    RCC_CR |= RCC_CR_PLLON;
    while ((RCC_CR & RCC_CR_PLLRDY) == 0) {
    }
    RCC_CFGR = RCC_CFGR_HPRE_2 | RCC_CFGR_SW_PLL;
    while ((RCC_CFGR & RCC_CFGR_SWS) != RCC_CFGR_SWS_PLL) {
    }
    for (volatile unsigned k = 0; k < 32u; k++) { /* 1 us and more */
    }
    RCC_CFGR = RCC_CFGR_SW_PLL;
}

static void begin_pins(void)
{
    RCC_AHB2ENR |= RCC_AHB2ENR_GPIOA | RCC_AHB2ENR_GPIOC;
    (void)RCC_AHB2ENR;
    set_alternate(GPIOA, 0, 1); /* TIM2_CH1 */
    set_alternate(GPIOA, 2, 7); /* USART2_TX */
    set_alternate(GPIOA, 3, 7); /* USART2_RX */
    set_alternate(GPIOA, 5, 5); /* SPI1_SCK */
    set_alternate(GPIOA, 7, 5); /* SPI1_MOSI */
    for (unsigned dac = 0; dac < DACS; dac++) {
        set_output(GPIOB, SYNC_PIN(dac), true);
    }
    for (unsigned line = 0; line < MARKER_LINES; line++) {
        set_output(GPIOC, line, false);
    }
    GPIOB->pupdr |= GPIO_PULL_UP << 2u * ESTOP_PIN;
    set_mode(GPIOB, ESTOP_PIN, GPIO_INPUT);
    SYSCFG_EXTICR1 = SYSCFG_EXTICR1_PB1;
    EXTI_RTSR1 = 1u << ESTOP_PIN; /* the pin rises when the contact opens */
    EXTI_IMR1 = 1u << ESTOP_PIN;
}

static void begin_timers(void)
{
    TIM2->ccmr1 = TIM_CCMR1_INACTIVE;
    TIM2->ccer = TIM_CCER_CC1E | TIM_CCER_CC1P;
    TIM2->psc = CLOCK_HZ / TICK_HZ - 1u;
    TIM2->arr = UINT32_MAX;
    TIM2->egr = TIM_EGR_UG;
    TIM2->dier = TIM_DIER_CC1IE;
    TIM2->cr1 = TIM_CR1_CEN;
    TIM6->psc = CLOCK_HZ / TICK_HZ - 1u;
    TIM6->dier = TIM_DIER_UIE;
}

/* 100 ms; once it runs, only a reset stops it. */
static void begin_watchdog(void)
{
    IWDG_KR = IWDG_KR_START;
    IWDG_KR = IWDG_KR_ACCESS;
    IWDG_PR = IWDG_PR_8;
    IWDG_RLR = 400u - 1u;
}

int main(void)
{
    begin_watchdog();
    begin_clock();
    RCC_APB1ENR1 |= RCC_APB1ENR1_TIM2 | RCC_APB1ENR1_TIM6 | RCC_APB1ENR1_USART2;
    RCC_APB2ENR |= RCC_APB2ENR_SYSCFG | RCC_APB2ENR_SPI1;
    (void)RCC_APB2ENR;
    begin_timers(); /* before the pins, so that LDAC is high from the start */
    begin_pins();
    SPI1_CR2 = SPI_CR2_12_BITS;
    SPI1_CR1 = SPI_CR1_SEND_ONLY | SPI_CR1_SSM | SPI_CR1_SSI | SPI_CR1_BR_4 | SPI_CR1_MSTR | SPI_CR1_CPHA;
    SPI1_CR1 |= SPI_CR1_SPE;
    USART2->brr = CLOCK_HZ / BIT_RATE;
    USART2->cr1 = USART_CR1_FIFOEN | USART_CR1_RXFNEIE | USART_CR1_TE | USART_CR1_RE | USART_CR1_UE;
    port_enable(USART2_IRQ, PORT_FIRST);
    port_enable(TIM2_IRQ, PORT_SECOND);
    port_enable(TIM6_IRQ, PORT_THIRD);
    port_enable(EXTI1_IRQ, PORT_THIRD);
    port_serve(&config);
}
