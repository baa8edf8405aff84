/* The amplifier on an LM3S6965 (Cortex-M3, 64 kB of RAM), the machine lm3s6965evb of QEMU:
 *
 *     qemu-system-arm -M lm3s6965evb -display none -monitor none -serial pty -kernel build/qemu-m3.elf
 *
 * What is wired to the part, were it real:
 *
 *     PA0, PA1    UART, 8N1, 1 Mbit/s
 *     PA2, PA5    clock and data of three AD5672R, 24 channels of 12 bits
 *     PB0 ... 2   SYNC of each AD5672R, low while it is loaded
 *     PB3         LDAC of all of them: low latches what was loaded
 *     PB4         enable of the high-voltage supply, low at reset by a resistor
 *     PB5         e-stop input: the normally closed contact to ground, which QEMU leaves closed
 *     PD4 ... 7   marker lines 0 ... 3; a resistor holds each low at reset
 *
 * QEMU has neither the DACs nor the supply, and it does not run in time as a part does: it shows that the port
 * boots and answers, not that it is in time.
 */
#include "registers.h"

#include "ad5672r.h"

/* The clock after reset. It is slow on purpose: SysTick, the only counter of this part that QEMU lets us read, has
 * 24 bits, and goes round in 1.3 s. An emulator that stood still for longer would lose time. */
#define TICK_HZ 12500000u
#define LEAD (TICK_HZ / 2000u) /* 0.5 ms from an instant to its latch: no masked section is as long */
#define BIT_RATE 1000000u
#define DACS (TA_CHANNELS / AD5672R_CHANNELS)

#define SYNC(dac) (1u << (dac))
#define SYNCS 0x07u
#define LDAC 0x08u
#define HIGH_VOLTAGE 0x10u
#define ESTOP 0x20u
#define PIXELS 0x80u
#define MARKERS 0xF0u /* of port D; QEMU has the chip select of an SD card on PD0 */

TA_ASSERT(channels_of_dacs, TA_CHANNELS % AD5672R_CHANNELS == 0);

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
    .marker_lines = 4,
    .lateness = LEAD,
    .tick_hz = TICK_HZ,
    .rate_min_hz = 2500,
    .rate_max_hz = 8000,
    .full_scale_uv = 100000000,
    .voltage_limit_uv = 100000000,
    .slew_limit_v_per_s = 700000,
    .fade_limit_us = 20000,
    .firmware = 0x00010000,
    .name = "qemu-m3",
};

const port_board board = {
    .counter_mask = SYSTICK_MASK,
    .lead = LEAD,
    .uart_irq = UART0_IRQ,
    .latch_irq = TIMER0_IRQ,
    .run_irq = TIMER1_IRQ,
};

/* Outputs */

/* At reset all pins are inputs, resistors hold the supply off, and the DACs are at 0 V. After a fault the supply
 * goes first, and then the DACs by the reset that follows. */
void board_outputs_off(void)
{
    RCGC2 |= RCGC2_GPIOB;
    (void)RCGC2; /* the clock of a port takes three cycles to start */
    (void)RCGC2;
    GPIO_DATA(GPIOB, HIGH_VOLTAGE) = 0;
    GPIO_DIR(GPIOB) |= HIGH_VOLTAGE;
    GPIO_DEN(GPIOB) |= HIGH_VOLTAGE;
}

void board_load(const int16_t *codes)
{
    for (size_t c = 0; c < TA_CHANNELS; c++) {
        uint32_t sync = SYNC(c / AD5672R_CHANNELS);
        GPIO_DATA(GPIOB, sync) = 0;
        pl022_write(SSI0, ad5672r_word(c, codes[c]));
        GPIO_DATA(GPIOB, sync) = sync;
    }
}

/* On this part the interrupt latches; where a timer can drive the pin itself, it should (see stm32g4). */
void board_latch(void)
{
    GPIO_DATA(GPIOB, LDAC) = 0;
    GPIO_DATA(GPIOB, LDAC) = LDAC;
}

void board_mark(uint8_t lines)
{
    GPIO_DATA(GPIOD, MARKERS) = (uint32_t)lines << 4;
}

void board_high_voltage(bool on)
{
    GPIO_DATA(GPIOB, HIGH_VOLTAGE) = on ? HIGH_VOLTAGE : 0u;
}

/* The closed contact pulls the pin down; a broken wire leaves it up, and stops as well. */
bool board_estop_open(void)
{
    return GPIO_DATA(GPIOB, ESTOP) != 0;
}

/* Time */

uint32_t board_counter(void)
{
    return SYSTICK_MASK - SYSTICK_CURRENT;
}

/* Lets a timer run out at `tick`, or at once. */
static void expire_at(uint32_t timer, uint64_t tick)
{
    uint64_t now = port_ticks();
    TIMER_CTL(timer) = 0;
    TIMER_LOAD(timer) = tick > now ? (uint32_t)(tick - now) : 1u;
    TIMER_CTL(timer) = TIMER_ENABLE;
}

void board_latch_at(uint64_t tick)
{
    expire_at(TIMER0, tick);
}

void board_run_at(uint64_t tick)
{
    expire_at(TIMER1, tick);
}

void board_feed_watchdog(void)
{
    WDT_ICR = 0;
}

/* Interrupts */

static void uart(void)
{
    pl011_interrupt(UART0);
}

static void latch(void)
{
    TIMER_ICR(TIMER0) = TIMER_TIMEOUT;
    port_latch();
}

static void run(void)
{
    TIMER_ICR(TIMER1) = TIMER_TIMEOUT;
    port_run();
}

PORT_INTERRUPTS = {[UART0_IRQ] = uart, [TIMER0_IRQ] = latch, [TIMER1_IRQ] = run};

/* Start */

/* QEMU has the display of the evaluation board on the same SPI. It takes the codes for pixels, which does no harm,
 * as long as PC7 is high, and else for commands. */
static void begin_pins(void)
{
    RCGC2 |= RCGC2_GPIOA | RCGC2_GPIOC | RCGC2_GPIOD;
    (void)RCGC2;
    (void)RCGC2;
    GPIO_AFSEL(GPIOA) = 0x27; /* UART and SSI */
    GPIO_DEN(GPIOA) = 0x27;
    GPIO_DATA(GPIOB, SYNCS | LDAC) = SYNCS | LDAC;
    GPIO_DIR(GPIOB) |= SYNCS | LDAC;
    GPIO_PUR(GPIOB) = ESTOP;
    GPIO_DEN(GPIOB) |= SYNCS | LDAC | ESTOP;
    GPIO_DIR(GPIOC) = PIXELS;
    GPIO_DEN(GPIOC) = PIXELS;
    GPIO_DATA(GPIOC, PIXELS) = PIXELS;
    GPIO_DIR(GPIOD) = MARKERS;
    GPIO_DEN(GPIOD) = MARKERS;
}

static void begin_timer(uint32_t timer)
{
    TIMER_CTL(timer) = 0;
    TIMER_CFG(timer) = 0; /* 32 bits */
    TIMER_MODE(timer) = TIMER_ONE_SHOT;
    TIMER_IMR(timer) = TIMER_TIMEOUT;
}

/* Two timeouts of a second: an emulator that stands still is no fault. A board takes some sample periods. */
static void begin_watchdog(void)
{
    WDT_LOAD = TICK_HZ;
    WDT_CTL = WDT_CTL_ENABLE;
}

int main(void)
{
    RCGC0 |= RCGC0_WDT;
    RCGC1 |= RCGC1_UART0 | RCGC1_SSI0 | RCGC1_TIMERS;
    begin_pins();
    begin_watchdog();
    SYSTICK_RELOAD = SYSTICK_MASK;
    SYSTICK_CURRENT = 0;
    SYSTICK_CTRL = SYSTICK_ENABLE;
    begin_timer(TIMER0);
    begin_timer(TIMER1);
    pl022_begin(SSI0, 2);
    pl011_begin(UART0, TICK_HZ, BIT_RATE);
    port_enable(UART0_IRQ, PORT_FIRST);
    port_enable(TIMER0_IRQ, PORT_SECOND);
    port_enable(TIMER1_IRQ, PORT_THIRD);
    port_serve(&config);
}
