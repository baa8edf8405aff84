/* What all ports share: startup, ticks, the rings of the UART, the queue of the outputs, and the loop around
 * the core. A port is a folder with main.c, which provides the functions that begin with board_, registers.h
 * and part.ld.
 *
 * There are four priorities. The interrupt of the UART stores bytes and stamps the time of each delimiter. The
 * interrupt of the latch puts out codes, each at its own time. The interrupt of the instants calls ta_run. The
 * main loop hands packets to the core.
 */
#ifndef PORT_H
#define PORT_H

#include "../../tactile_link.h"

#ifndef PORT_RX
#define PORT_RX 2048u /* bytes that may come while a packet is handled, with 8 more for each delimiter */
#endif
#ifndef PORT_TX
#define PORT_TX 1024u /* bytes that wait to be sent */
#endif
#ifndef PORT_QUEUE
#define PORT_QUEUE 16u /* instants that wait for their latch */
#endif

/* The board: what main.c of a port provides. */

typedef struct {
    uint32_t counter_mask; /* largest value of the counter, 2^n - 1 */
    uint32_t lead;         /* ticks from an instant to its latch; the core may be late by as much */
    unsigned uart_irq;     /* interrupts that common code pends or masks */
    unsigned latch_irq;
    unsigned run_irq;
} port_board;

extern const port_board board;

/* Puts the outputs to 0 V and switches the high voltage off. It is the first thing after reset and the last one
 * after a fault of the processor, so that it relies on no variable and no clock. */
void board_outputs_off(void);

/* Returns the free-running counter of ticks, which is read at least once in each of its rounds. */
uint32_t board_counter(void);

/* Interrupts at a tick, or at once if that has passed: of the latch, and of the instants. */
void board_latch_at(uint64_t tick);
void board_run_at(uint64_t tick);

/* Loads the codes of all channels into the DACs, whose outputs stay as they are. */
void board_load(const int16_t *codes);

/* Puts out what has been loaded, unless a pin of the timer has done that already. */
void board_latch(void);

/* Sets the marker lines, all of them at once: line k is high where bit k is set. It is called directly after
 * board_latch, at the latch with which they change. */
void board_mark(uint8_t lines);

void board_high_voltage(bool on);
bool board_estop_open(void);
void board_feed_watchdog(void);

/* What the interrupts of the board call. */

/* Stores a byte of the UART, and of a delimiter the time. */
void port_received(uint8_t byte);

/* Returns the next byte to send, or -1 for none. */
int port_next_byte(void);

/* Puts out what is due; called by the interrupt of the latch. */
void port_latch(void);

/* Carries out the instants that are due; called by the interrupt of the instants. */
void port_run(void);

/* Reads the e-stop input soon; called by an interrupt of its pin. */
void port_estop_moved(void);

/* What main calls once the board is set up. Serves the host forever; with a configuration that SPEC.md forbids it
 * names the field on the UART instead, and waits for the watchdog. */
void port_serve(const ta_config *config) __attribute__((noreturn));

/* Parts of common code. */

/* Returns the ticks since power-up. */
uint64_t port_ticks(void);

/* Takes bytes that came, up to `size` or a delimiter. Gives the tick of the delimiter, or the present one. */
size_t port_take(uint8_t *bytes, size_t size, uint64_t *tick);

/* Queues bytes to send: all of them, or none and false. */
bool port_write(void *context, const uint8_t *bytes, size_t size);

/* Queues the codes of an instant; waits while the queue is full. */
void port_put_out(void *context, uint64_t tick, uint32_t position, const int16_t *codes);

/* Sets the marker lines that are queued with the codes from the next instant on. */
void port_marks(void *context, uint8_t lines);

/* The processor: the table of vectors, and interrupts (Armv6-M and Armv7-M, B3.4 NVIC). */

typedef void (*port_handler)(void);

/* Handlers by number; a number that has none is never enabled. */
#define PORT_INTERRUPTS \
    const port_handler port_interrupts[] __attribute__((section(".vectors.interrupts"), used))

#define PORT_REGISTER(address) (*(volatile uint32_t *)(address))
#define PORT_NVIC 0xE000E000u

/* Priorities, which the four levels of any Cortex-M have; the main loop has none. */
#define PORT_FIRST 0x00u
#define PORT_SECOND 0x40u
#define PORT_THIRD 0x80u

static inline void port_pend(unsigned irq)
{
    PORT_REGISTER(PORT_NVIC + 0x200u + irq / 32u * 4u) = 1u << irq % 32u;
}

static inline void port_unmask(unsigned irq)
{
    PORT_REGISTER(PORT_NVIC + 0x100u + irq / 32u * 4u) = 1u << irq % 32u;
}

/* The barriers let no instruction after it run before the interrupt is off. */
static inline void port_mask(unsigned irq)
{
    PORT_REGISTER(PORT_NVIC + 0x180u + irq / 32u * 4u) = 1u << irq % 32u;
    __asm__ volatile("dsb\n\tisb" ::: "memory");
}

static inline void port_enable(unsigned irq, uint32_t priority)
{
    volatile uint32_t *four = &PORT_REGISTER(PORT_NVIC + 0x400u + irq / 4u * 4u);
    unsigned shift = irq % 4u * 8u; /* Armv6-M writes words only */
    *four = (*four & ~(0xFFu << shift)) | priority << shift;
    port_unmask(irq);
}

static inline void port_sleep(void)
{
    __asm__ volatile("wfi" ::: "memory");
}

#endif
