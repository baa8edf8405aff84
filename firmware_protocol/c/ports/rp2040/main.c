/* The amplifier on an RP2040 (Cortex-M0+ at 125 MHz), for example on a Raspberry Pi Pico, without its SDK. It has
 * been compiled, and has not run on a board. The second core stays in the boot ROM.
 *
 *     GP0, GP1      UART, 8N1, 1 Mbit/s
 *     GP2 ... 9     marker lines 0 ... 7, which the pads pull low at reset
 *     GP17          SYNC of an AD5672R, 8 channels of 12 bits, low while it is loaded
 *     GP18, GP19    clock and data of the DAC
 *     GP20          LDAC: low latches what was loaded
 *     GP21          enable of the high-voltage supply, which the pad pulls low at reset
 *     GP22          e-stop input: the normally closed contact to ground
 *     RUN           with the RESET of the DAC at the output of a supervisor of the supply, so that both are reset
 *                   at power-up and brown-out. A reset by the watchdog does not pull RUN: it switches the supply
 *                   off, whose bleeder brings the outputs to 0 V (duty 9)
 *
 * The contact is in series with GP21 and the supply as well (6.3), which no firmware can replace.
 */
#include "registers.h"

#include "ad5672r.h"

#define CRYSTAL_HZ 12000000u
#define CLOCK_HZ 125000000u
#define TICK_HZ 1000000u
#define LEAD (TICK_HZ / 1000u) /* 1 ms from an instant to its latch: no masked section is as long */
#define BIT_RATE 1000000u

#define FIRST_MARKER_PIN 2u
#define MARKER_LINES 8u
#define MARKERS(lines) ((uint32_t)(lines) << FIRST_MARKER_PIN)
#define SYNC (1u << 17)
#define LDAC (1u << 20)
#define HIGH_VOLTAGE_PIN 21u
#define HIGH_VOLTAGE (1u << HIGH_VOLTAGE_PIN)
#define ESTOP_PIN 22u
#define ESTOP (1u << ESTOP_PIN)

#define LATCH_ALARM 0u
#define RUN_ALARM 1u

TA_ASSERT(channels_of_dac, TA_CHANNELS <= AD5672R_CHANNELS);

/* The properties of the board, which CAPS tells to the host. TA_CHANNELS, TA_FIFO and others are set in the
 * Makefile, since they are sizes of arrays. */
static const ta_config config = {
    .node = 1,
    .channels = TA_CHANNELS,
    .carriers = 0, /* this core has no time for 16 carriers of 8 channels */
    .holds = true, /* the DAC holds each sample */
    .formats = 0x07,
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
    .name = "rp2040",
};

const port_board board = {
    .counter_mask = UINT32_MAX,
    .lead = LEAD,
    .uart_irq = UART0_IRQ,
    .latch_irq = TIMER_0_IRQ,
    .run_irq = TIMER_1_IRQ,
};

/* Outputs */

static void begin_peripherals(uint32_t which)
{
    CLEAR(RESETS_RESET) = which;
    while ((RESETS_DONE & which) != which) {
    }
}

/* At reset the pads pull down, so that the supply is off. After a fault it goes first, and then the rest by the
 * reset that follows. */
void board_outputs_off(void)
{
    begin_peripherals(RESETS_IO_BANK0 | RESETS_PADS_BANK0);
    SIO_OUT_CLEAR = HIGH_VOLTAGE;
    SIO_OE_SET = HIGH_VOLTAGE;
    GPIO_CTRL(HIGH_VOLTAGE_PIN) = GPIO_SIO;
}

void board_load(const int16_t *codes)
{
    for (size_t c = 0; c < TA_CHANNELS; c++) {
        SIO_OUT_CLEAR = SYNC;
        pl022_write(SPI0, ad5672r_word(c, codes[c]));
        SIO_OUT_SET = SYNC;
    }
}

/* The interrupt latches, some microseconds after the tick. A state machine of the PIO could do it at the tick. */
void board_latch(void)
{
    SIO_OUT_CLEAR = LDAC;
    SIO_OUT_CLEAR = LDAC; /* for 20 ns at least */
    SIO_OUT_CLEAR = LDAC;
    SIO_OUT_SET = LDAC;
}

/* One write changes all of them; nobody else changes these bits. */
void board_mark(uint8_t lines)
{
    SIO_OUT_TOGGLE = (SIO_OUT ^ MARKERS(lines)) & MARKERS(0xFFu);
}

void board_high_voltage(bool on)
{
    if (on) {
        SIO_OUT_SET = HIGH_VOLTAGE;
    } else {
        SIO_OUT_CLEAR = HIGH_VOLTAGE;
    }
}

/* The closed contact pulls the pin down; a broken wire leaves it up, and stops as well. */
bool board_estop_open(void)
{
    return (SIO_IN & ESTOP) != 0;
}

/* Time */

uint32_t board_counter(void)
{
    return TIMER_RAW;
}

/* An alarm is for one value of the counter; one that has passed is made up for by the interrupt itself. */
void board_latch_at(uint64_t tick)
{
    TIMER_ALARM(LATCH_ALARM) = (uint32_t)tick;
}

void board_run_at(uint64_t tick)
{
    TIMER_ALARM(RUN_ALARM) = (uint32_t)tick;
    if (port_ticks() >= tick) {
        port_pend(TIMER_1_IRQ);
    }
}

/* 100 ms; the watchdog counts twice in each microsecond (erratum RP2040-E1). */
void board_feed_watchdog(void)
{
    WATCHDOG_LOAD = 2u * 100000u;
}

/* Interrupts */

static void uart(void)
{
    pl011_interrupt(UART0);
}

static void latch(void)
{
    TIMER_INTR = 1u << LATCH_ALARM;
    port_latch();
}

static void run(void)
{
    TIMER_INTR = 1u << RUN_ALARM;
    port_run();
}

static void estop(void)
{
    GPIO_INTR(ESTOP_PIN) = GPIO_RISES(ESTOP_PIN);
    port_estop_moved();
}

PORT_INTERRUPTS = {
    [TIMER_0_IRQ] = latch, [TIMER_1_IRQ] = run, [IO_BANK0_IRQ] = estop, [UART0_IRQ] = uart};

/* Start */

/* 12 MHz x 125 / 6 / 2; the timer and the watchdog count microseconds of the crystal. */
static void begin_clock(void)
{
    XOSC_STARTUP = 47; /* 1 ms, in steps of 256 periods */
    XOSC_CTRL = XOSC_ENABLE;
    while ((XOSC_STATUS & XOSC_STABLE) == 0) {
    }
    CLK_REF_CTRL = CLK_REF_XOSC;
    while ((CLK_REF_SELECTED & 1u << CLK_REF_XOSC) == 0) {
    }
    begin_peripherals(RESETS_PLL_SYS);
    PLL_CS = 1; /* the crystal's frequency as it is */
    PLL_FBDIV = 125;
    CLEAR(PLL_PWR) = PLL_PWR_PD | PLL_PWR_VCOPD;
    while ((PLL_CS & PLL_CS_LOCK) == 0) {
    }
    PLL_PRIM = PLL_PRIM_DIVIDERS(6u, 2u);
    CLEAR(PLL_PWR) = PLL_PWR_POSTDIVPD;
    CLK_SYS_CTRL = CLK_SYS_PLL;
    while ((CLK_SYS_SELECTED & 1u << CLK_SYS_PLL) == 0) {
    }
    CLK_PERI_CTRL = CLK_PERI_ENABLE;
    WATCHDOG_TICK = WATCHDOG_TICK_ENABLE | CRYSTAL_HZ / TICK_HZ;
}

/* Without the bits PAUSE_DBG, which are set at reset: a debugger that halts the program stops the outputs as well. */
static void begin_watchdog(void)
{
    PSM_WDSEL = PSM_ALL_BUT_OSCILLATORS;
    board_feed_watchdog();
    WATCHDOG_CTRL = WATCHDOG_ENABLE;
}

static void begin_pins(void)
{
    SIO_OUT_SET = SYNC | LDAC;
    SIO_OE_SET = SYNC | LDAC | MARKERS(0xFFu);
    PAD(ESTOP_PIN) = PAD_INPUT_PULL_UP;
    GPIO_CTRL(0) = GPIO_UART;
    GPIO_CTRL(1) = GPIO_UART;
    for (uint32_t line = 0; line < MARKER_LINES; line++) {
        GPIO_CTRL(FIRST_MARKER_PIN + line) = GPIO_SIO;
    }
    GPIO_CTRL(17) = GPIO_SIO;
    GPIO_CTRL(18) = GPIO_SPI;
    GPIO_CTRL(19) = GPIO_SPI;
    GPIO_CTRL(20) = GPIO_SIO;
    GPIO_CTRL(ESTOP_PIN) = GPIO_SIO;
    GPIO_INTE(ESTOP_PIN) = GPIO_RISES(ESTOP_PIN); /* the pin rises when the contact opens */
}

int main(void)
{
    begin_clock();
    begin_watchdog();
    begin_pins();
    begin_peripherals(RESETS_UART0 | RESETS_SPI0 | RESETS_TIMER);
    SET(TIMER_INTE) = 1u << LATCH_ALARM | 1u << RUN_ALARM;
    pl022_begin(SPI0, 4); /* 31 MHz, of at most 50 */
    pl011_begin(UART0, CLOCK_HZ, BIT_RATE);
    port_enable(TIMER_0_IRQ, PORT_FIRST); /* latches; the UART has a FIFO of 32 bytes */
    port_enable(UART0_IRQ, PORT_SECOND);
    port_enable(TIMER_1_IRQ, PORT_THIRD);
    port_enable(IO_BANK0_IRQ, PORT_THIRD);
    port_serve(&config);
}
