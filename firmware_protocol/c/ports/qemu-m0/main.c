/* The amplifier on an nRF51822 (Cortex-M0 at 16 MHz, 16 kB of RAM), the machine microbit of QEMU:
 *
 *     qemu-system-arm -M microbit -display none -monitor none -serial pty -kernel build/qemu-m0.elf
 *
 * It shows how small an amplifier can be: four channels at 2.5 kHz. What is wired to the BBC micro:bit, were it real:
 *
 *     P0.24, P0.25    UART, 8N1, 1 Mbit/s
 *     P0.16           SYNC of an AD5672R, 12 bits, low while it is loaded
 *     P0.21, P0.23    data and clock of the DAC, which firmware moves
 *     P0.22           LDAC: low latches what was loaded
 *     P0.18           enable of the high-voltage supply, low at reset by a resistor
 *     P0.17           e-stop input: the button A
 *     P0.01 ... 03    marker lines 0 ... 2, the contacts 2, 1 and 0 of the edge; a resistor holds each low at reset
 *
 * QEMU has neither the DAC nor the supply nor the watchdog, and it does not run in time as a part does: it shows that
 * the port boots and answers, not that it is in time.
 */
#include "registers.h"

#include "ad5672r.h"

#define TICK_HZ 1000000u
#define LEAD (TICK_HZ / 500u) /* 2 ms from an instant to its latch: no masked section is as long */
#define PRESCALER 4u /* 16 MHz / 2^4 */

#define SYNC (1u << 16)
#define DATA (1u << 21)
#define LDAC (1u << 22)
#define CLOCK (1u << 23)
#define HIGH_VOLTAGE (1u << 18)
#define ESTOP_PIN 17u
#define ESTOP (1u << ESTOP_PIN)
#define MARKER_LINES 3u
#define MARKERS(lines) ((uint32_t)(lines) << 1)
#define TX_PIN 24u
#define RX_PIN 25u

TA_ASSERT(channels_of_dac, TA_CHANNELS <= AD5672R_CHANNELS);

/* The properties of the board, which CAPS tells to the host. TA_CHANNELS, TA_FIFO and others are set in the
 * Makefile, since they are sizes of arrays. */
static const ta_config config = {
    .node = 1,
    .channels = TA_CHANNELS,
    .carriers = 0, /* this core has no time for them */
    .holds = true, /* the DAC holds each sample */
    .formats = 0x07,
    .packet_limit = TA_PACKET_MAX,
    .fifo_samples = TA_FIFO,
    .marker_lines = MARKER_LINES,
    .lateness = LEAD,
    .tick_hz = TICK_HZ,
    .rate_min_hz = 1000,
    .rate_max_hz = 2500,
    .full_scale_uv = 100000000,
    .voltage_limit_uv = 100000000,
    .slew_limit_v_per_s = 700000,
    .fade_limit_us = 20000,
    .firmware = 0x00010000,
    .name = "qemu-m0",
};

const port_board board = {
    .counter_mask = UINT32_MAX,
    .lead = LEAD,
    .uart_irq = UART_IRQ,
    .latch_irq = TIMER0_IRQ,
    .run_irq = TIMER1_IRQ,
};

/* Outputs */

/* At reset all pins are inputs, a resistor holds the supply off, and the DAC is at 0 V. After a fault the supply goes
 * first, and then the DAC by the reset that follows. */
void board_outputs_off(void)
{
    GPIO_OUT_CLEAR = HIGH_VOLTAGE;
    GPIO_OUTPUTS_SET = HIGH_VOLTAGE;
}

/* The DAC takes a bit when its clock falls. */
static void send_word(uint32_t word)
{
    GPIO_OUT_CLEAR = SYNC;
    for (uint32_t bit = 1u << 23; bit != 0; bit >>= 1) {
        GPIO_OUT_SET = (word & bit) != 0 ? CLOCK | DATA : CLOCK;
        GPIO_OUT_CLEAR = (word & bit) != 0 ? CLOCK : CLOCK | DATA;
    }
    GPIO_OUT_SET = SYNC;
}

void board_load(const int16_t *codes)
{
    for (size_t c = 0; c < TA_CHANNELS; c++) {
        send_word(ad5672r_word(c, codes[c]));
    }
}

/* The interrupt latches; the part's GPIOTE could do it at the tick. */
void board_latch(void)
{
    GPIO_OUT_CLEAR = LDAC;
    GPIO_OUT_SET = LDAC;
}

/* Both writes are within 1 us. */
void board_mark(uint8_t lines)
{
    GPIO_OUT_CLEAR = MARKERS(~lines & 7u);
    GPIO_OUT_SET = MARKERS(lines);
}

void board_high_voltage(bool on)
{
    if (on) {
        GPIO_OUT_SET = HIGH_VOLTAGE;
    } else {
        GPIO_OUT_CLEAR = HIGH_VOLTAGE;
    }
}

/* A button of this board closes to ground when it is pressed. The contact of a real e-stop opens instead, so that a
 * broken wire stops as well: there the input is open while the pin is high, as in the other ports. */
bool board_estop_open(void)
{
    return (GPIO_IN & ESTOP) == 0;
}

/* Time */

/* CC[0] of TIMER0 belongs to the latch; the counter is read through CC[1]. */
uint32_t board_counter(void)
{
    TIMER_CAPTURE(TIMER0, 1u) = 1;
    return TIMER_CC(TIMER0, 1u);
}

void board_latch_at(uint64_t tick)
{
    TIMER_CC(TIMER0, 0u) = (uint32_t)tick;
}

/* TIMER1 has 16 bits, 65 ms: it may interrupt too early, and is set again. */
void board_run_at(uint64_t tick)
{
    uint64_t now = port_ticks();
    uint64_t left = tick > now ? tick - now : 1u;
    TIMER_STOP(TIMER1) = 1;
    TIMER_CLEAR(TIMER1) = 1;
    TIMER_CC(TIMER1, 0u) = left < UINT16_MAX ? (uint32_t)left : UINT16_MAX;
    TIMER_START(TIMER1) = 1;
}

void board_feed_watchdog(void)
{
    WDT_RELOAD = WDT_RELOAD_KEY;
}

/* Interrupts */

static void uart(void)
{
    static bool sending;
    while (UART_RXDRDY != 0) {
        UART_RXDRDY = 0;
        port_received((uint8_t)UART_RXD);
    }
    if (UART_TXDRDY != 0) {
        UART_TXDRDY = 0;
        sending = false;
    }
    if (!sending) {
        int byte = port_next_byte();
        if (byte >= 0) {
            UART_TXD = (uint32_t)byte;
            sending = true;
        }
    }
}

static void latch(void)
{
    TIMER_COMPARE(TIMER0, 0u) = 0;
    port_latch();
}

static void run(void)
{
    TIMER_COMPARE(TIMER1, 0u) = 0;
    port_run();
}

PORT_INTERRUPTS = {[UART_IRQ] = uart, [TIMER0_IRQ] = latch, [TIMER1_IRQ] = run};

/* Start */

static void begin_pins(void)
{
    GPIO_OUT_SET = SYNC | LDAC;
    GPIO_OUTPUTS_SET = SYNC | LDAC | CLOCK | DATA | MARKERS(7u);
    GPIO_PIN(ESTOP_PIN) = GPIO_PIN_PULL_UP;
}

static void begin_timers(void)
{
    TIMER_BITMODE(TIMER0) = TIMER_32_BITS;
    TIMER_PRESCALER(TIMER0) = PRESCALER;
    TIMER_INTENSET(TIMER0) = TIMER_INTERRUPT(0u);
    TIMER_START(TIMER0) = 1;
    TIMER_BITMODE(TIMER1) = TIMER_16_BITS;
    TIMER_PRESCALER(TIMER1) = PRESCALER;
    TIMER_SHORTS(TIMER1) = TIMER_STOPS(0u);
    TIMER_INTENSET(TIMER1) = TIMER_INTERRUPT(0u);
}

static void begin_uart(void)
{
    GPIO_OUT_SET = 1u << TX_PIN;
    GPIO_OUTPUTS_SET = 1u << TX_PIN;
    UART_PIN_TX = TX_PIN;
    UART_PIN_RX = RX_PIN;
    UART_BAUDRATE = UART_1_MBIT_PER_S;
    UART_ENABLE = UART_ENABLED;
    UART_INTENSET = UART_INTERRUPTS;
    UART_START_RX = 1;
    UART_START_TX = 1;
}

int main(void)
{
    CLOCK_START_CRYSTAL = 1; /* until it runs, the clock of the part is an RC oscillator */
    WDT_LOAD = 3276;         /* 100 ms */
    WDT_START = 1;
    begin_pins();
    begin_timers();
    begin_uart();
    port_enable(UART_IRQ, PORT_FIRST);
    port_enable(TIMER0_IRQ, PORT_SECOND);
    port_enable(TIMER1_IRQ, PORT_THIRD);
    port_serve(&config);
}
