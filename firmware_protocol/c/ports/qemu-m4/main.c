/* The amplifier on a Cortex-M4 of Arm's MPS2 board, the machine mps2-an386 of QEMU:
 *
 *     qemu-system-arm -M mps2-an386 -display none -monitor none -serial pty -kernel build/qemu-m4.elf
 *
 * What is wired to the part, were it real:
 *
 *     UART0           8N1, 1 Mbit/s
 *     SPI0            clock and data of three AD5672R, 24 channels of 12 bits
 *     GPIO 0 ... 2    SYNC of each AD5672R, low while it is loaded
 *     GPIO 3          LDAC of all of them: low latches what was loaded
 *     GPIO 4          enable of the high-voltage supply, low at reset by a resistor
 *     GPIO 5          e-stop input: the normally closed contact to ground, with a pull-up, which QEMU leaves closed
 *     GPIO 8 ... 15   marker lines 0 ... 7; a resistor holds each low at reset
 *
 * QEMU has neither the DACs nor the supply nor this GPIO, and it does not run in time as a part does: it shows that
 * the port boots and answers, not that it is in time.
 */
#include "registers.h"

#include "ad5672r.h"

#define TICK_HZ 25000000u /* the clock of the board */
#define LEAD (TICK_HZ / 2000u) /* 0.5 ms from an instant to its latch: no masked section is as long */
#define BIT_RATE 1000000u
#define DACS (TA_CHANNELS / AD5672R_CHANNELS)

#define SYNC(dac) (1u << (dac))
#define SYNCS 0x07u
#define LDAC 0x08u
#define HIGH_VOLTAGE 0x10u
#define ESTOP 0x20u
#define MARKERS(lines) ((uint32_t)(lines) << 8)

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
    .marker_lines = 8,
    .lateness = LEAD,
    .tick_hz = TICK_HZ,
    .rate_min_hz = 2500,
    .rate_max_hz = 8000,
    .full_scale_uv = 100000000,
    .voltage_limit_uv = 100000000,
    .slew_limit_v_per_s = 700000,
    .fade_limit_us = 20000,
    .firmware = 0x00010000,
    .name = "qemu-m4",
};

const port_board board = {
    .counter_mask = UINT32_MAX,
    .lead = LEAD,
    .uart_irq = UART_TX_IRQ,
    .latch_irq = TIMER0_IRQ,
    .run_irq = TIMER1_IRQ,
};

/* Outputs */

/* At reset all pins are inputs, a resistor holds the supply off, and the DACs are at 0 V. After a fault the supply
 * goes first, and then the DACs by the reset that follows. */
void board_outputs_off(void)
{
    GPIO_MASKED(HIGH_VOLTAGE) = 0;
    GPIO_OUTPUTS = HIGH_VOLTAGE;
}

void board_load(const int16_t *codes)
{
    for (size_t c = 0; c < TA_CHANNELS; c++) {
        uint32_t sync = SYNC(c / AD5672R_CHANNELS);
        GPIO_MASKED(sync) = 0;
        pl022_write(SPI0, ad5672r_word(c, codes[c]));
        GPIO_MASKED(sync) = sync;
    }
}

/* On this part the interrupt latches; where a timer can drive the pin itself, it should (see stm32g4). */
void board_latch(void)
{
    GPIO_MASKED(LDAC) = 0;
    GPIO_MASKED(LDAC) = LDAC;
}

void board_mark(uint8_t lines)
{
    GPIO_MASKED_HIGH(0xFFu) = MARKERS(lines);
}

void board_high_voltage(bool on)
{
    GPIO_MASKED(HIGH_VOLTAGE) = on ? HIGH_VOLTAGE : 0u;
}

/* The closed contact pulls the pin down; a broken wire leaves it up, and stops as well. */
bool board_estop_open(void)
{
    return (GPIO_DATA & ESTOP) != 0;
}

/* Time */

uint32_t board_counter(void)
{
    return UINT32_MAX - DUAL_VALUE;
}

/* Lets a timer run out at `tick`, or at once; its interrupt stops it. */
static void expire_at(timer *which, uint64_t tick)
{
    uint64_t now = port_ticks();
    which->ctrl = 0;
    which->value = tick > now ? (uint32_t)(tick - now) : 1u;
    which->ctrl = TIMER_ENABLE | TIMER_INTERRUPT;
}

static void stop(timer *which)
{
    which->ctrl = 0;
    which->intclear = 1;
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
    WATCHDOG_INTCLEAR = 0;
}

/* Interrupts */

/* Of both directions; without a FIFO a byte has to be read before the next one has come. */
static void uart(void)
{
    UART_INTCLEAR = UART_INT_ALL;
    while ((UART_STATE & UART_STATE_RX_FULL) != 0) {
        port_received((uint8_t)UART_DATA);
    }
    while ((UART_STATE & UART_STATE_TX_FULL) == 0) {
        int byte = port_next_byte();
        if (byte < 0) {
            break;
        }
        UART_DATA = (uint32_t)byte;
    }
}

static void latch(void)
{
    stop(TIMER0);
    port_latch();
}

static void run(void)
{
    stop(TIMER1);
    port_run();
}

PORT_INTERRUPTS = {
    [UART_RX_IRQ] = uart, [UART_TX_IRQ] = uart, [TIMER0_IRQ] = latch, [TIMER1_IRQ] = run};

/* Start */

int main(void)
{
    GPIO_MASKED(SYNCS | LDAC) = SYNCS | LDAC;
    GPIO_OUTPUTS = SYNCS | LDAC | MARKERS(0xFFu);
    WATCHDOG_LOAD = TICK_HZ; /* a second: an emulator that stands still is no fault. A board takes less */
    WATCHDOG_CTRL = WATCHDOG_ENABLE;
    DUAL_CONTROL = DUAL_32_BITS | DUAL_ENABLE;
    TIMER0->reload = UINT32_MAX;
    TIMER1->reload = UINT32_MAX;
    pl022_begin(SPI0, 2);
    UART_DIVIDER = TICK_HZ / BIT_RATE;
    UART_CTRL = UART_CTRL_ENABLE;
    port_enable(UART_RX_IRQ, PORT_FIRST);
    port_enable(UART_TX_IRQ, PORT_FIRST);
    port_enable(TIMER0_IRQ, PORT_SECOND);
    port_enable(TIMER1_IRQ, PORT_THIRD);
    port_serve(&config);
}
