/* The core between its interrupt and the main loop. */
#include "port.h"

#include <string.h>

static ta_amplifier amp;
static ta_serial serial;
static volatile uint32_t runs;
static volatile bool estop_moved;

uint64_t port_ticks(void)
{
    static uint64_t ticks;
    uint32_t masked;
    __asm__ volatile("mrs %0, primask\n\tcpsid i" : "=r"(masked)::"memory");
    ticks += (board_counter() - (uint32_t)ticks) & board.counter_mask;
    uint64_t now = ticks;
    __asm__ volatile("msr primask, %0" ::"r"(masked) : "memory");
    return now;
}

/* The functions of the core's HAL */

static bool send(void *context, const uint8_t *packet, size_t size)
{
    (void)context;
    return ta_serial_send(&serial, packet, size);
}

static void high_voltage(void *context, bool on)
{
    (void)context;
    board_high_voltage(on);
}

static bool estop_open(void *context)
{
    (void)context;
    return board_estop_open();
}

static uint64_t clock(void *context)
{
    (void)context;
    return port_ticks();
}

static void mask(void *context)
{
    (void)context;
    port_mask(board.run_irq);
}

static void unmask(void *context)
{
    (void)context;
    port_unmask(board.run_irq);
}

static const ta_hal hal = {
    .send = send,
    .put_out = port_put_out,
    .marks = port_marks,
    .high_voltage = high_voltage,
    .estop_open = estop_open,
    .mask = mask,
    .unmask = unmask,
    .clock = clock,
};

/* The interrupt of the instants */

void port_run(void)
{
    uint64_t now = port_ticks();
    if (estop_moved) {
        estop_moved = false;
        ta_estop_input(&amp, now);
    }
    ta_run(&amp, now);
    runs++;
    board_run_at(ta_next_instant(&amp));
}

void port_estop_moved(void)
{
    estop_moved = true;
    port_pend(board.run_irq);
}

/* The main loop */

/* Hands bytes to the core, which instants may interrupt but where it masks them. A packet may have changed the next
 * instant. */
static void handle(const uint8_t *bytes, size_t size, uint64_t tick)
{
    ta_serial_feed(&serial, bytes, size, tick);
    mask(NULL);
    board_run_at(ta_next_instant(&amp));
    unmask(NULL);
}

static void print(const char *text)
{
    port_write(NULL, (const uint8_t *)text, strlen(text));
}

static void print_number(uint32_t value)
{
    char digits[11];
    char *digit = digits + sizeof digits - 1;
    *digit = '\0';
    do {
        *--digit = (char)('0' + value % 10u);
        value /= 10u;
    } while (value > 0);
    print(digit);
}

/* Names what SPEC.md forbids, at 0 V and without high voltage. As nothing feeds the watchdog, it resets the part,
 * and whoever looks at the UART later reads the line as well. */
__attribute__((noreturn)) static void refuse(const ta_bounds *fault)
{
    print("not started: ");
    print(fault->field);
    if (fault->most != 0) {
        print(" is ");
        print_number(fault->value);
        print(fault->value < fault->least ? ", and has to be at least " : ", and has to be at most ");
        print_number(fault->value < fault->least ? fault->least : fault->most);
    } else {
        print(" is not allowed");
    }
    print("\n");
    for (;;) {
        port_sleep();
    }
}

void port_serve(const ta_config *config)
{
    static const uint8_t delimiter = 0;
    uint8_t bytes[64];
    uint32_t fed = 0;
    ta_bounds fault;
    if (ta_config_fault(config, &hal, &fault) != NULL) {
        refuse(&fault);
    }
    ta_init(&amp, config, &hal);
    ta_serial_init(&serial, &amp, port_write, NULL);
    port_write(NULL, &delimiter, 1); /* a sender that starts sends one first (3.1) */
    port_pend(board.run_irq);
    for (;;) {
        uint64_t tick;
        size_t size = port_take(bytes, sizeof bytes, &tick);
        if (runs != fed) { /* both the instants and this loop go on */
            fed = runs;
            board_feed_watchdog();
        }
        if (size > 0) {
            handle(bytes, size, tick);
        }
        ta_serve(&amp); /* sends what the instants have to report */
        if (size == 0) {
            port_sleep();
        }
    }
}
