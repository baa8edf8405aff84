/* A Cortex-M of QEMU (mps2-an386 and mps2-an385) at power-up: vectors, memory, counter, semihosting. */
#include "machine.h"

#include <string.h>

#define TIMER_VALUE (*(volatile uint32_t *)0x40000004u) /* CMSDK timer 0, which counts down */
#define TIMER_RELOAD (*(volatile uint32_t *)0x40000008u)
#define TIMER_CONTROL (*(volatile uint32_t *)0x40000000u)
#define SYSTICK_CONTROL (*(volatile uint32_t *)0xE000E010u) /* it counts down at 25 MHz too */
#define SYSTICK_RELOAD (*(volatile uint32_t *)0xE000E014u)
#define SYSTICK_VALUE (*(volatile uint32_t *)0xE000E018u)
#define SYSTICK_RUNS 7u
#define INTERRUPT_CONTROL (*(volatile uint32_t *)0xE000ED04u)
#define SYSTICK_CLEAR (1u << 25)
#define PAINT 0xDEADBEEFu

/* Semihosting (Arm, "Semihosting for AArch32 and AArch64"). */
#define SYS_OPEN 1u
#define SYS_WRITE0 4u
#define SYS_WRITE 5u
#define SYS_EXIT_EXTENDED 0x20u
#define MODE_WB 5u
#define STOPPED_RUN_TIME_ERROR 0x20023u
#define STOPPED_APPLICATION_EXIT 0x20026u

extern uint32_t data_load, data_begin, data_end, bss_begin, bss_end, stack_top;

int main(void);
void reset(void);

/* Interrupts; a program without uart.c has none. */
void uart0_received(void) __attribute__((weak));
void uart1_received(void) __attribute__((weak));

static uint32_t semihost(uint32_t operation, const void *argument)
{
    register uint32_t r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

void machine_exit(bool good)
{
    uint32_t block[2] = {STOPPED_APPLICATION_EXIT, good ? 0u : 1u};
    (void)semihost(SYS_EXIT_EXTENDED, block);
    for (;;) {
    }
}

static void fault(void)
{
    machine_print("fault of the processor\n");
    machine_exit(false);
}

static void (*interrupt)(void);

static void systick(void)
{
    SYSTICK_CONTROL = 0;
    interrupt();
}

/* The stack is painted from the end of the variables up to where it is in use already. */
static void paint_stack(void)
{
    uint32_t *top;
    __asm__ volatile("mov %0, sp" : "=r"(top));
    for (uint32_t *word = &bss_end; word < top; word++) {
        *word = PAINT;
    }
}

void reset(void)
{
    memcpy(&data_begin, &data_load, (size_t)((char *)&data_end - (char *)&data_begin));
    memset(&bss_begin, 0, (size_t)((char *)&bss_end - (char *)&bss_begin));
    paint_stack();
    machine_exit(main() == 0);
}

/* Table of vectors of ARMv6-M and ARMv7-M: the stack, the handlers of reset, of faults and of the system, none of
 * which is called by what runs here but that of SysTick, then those of the interrupts 0 to 2. */
static const struct {
    uint32_t *stack;
    void (*handlers[15])(void);
    void (*interrupts[3])(void);
} vectors __attribute__((section(".vectors"), used)) = {
    &stack_top,
    {reset, fault, fault, fault, fault, fault, NULL, NULL, NULL, NULL, fault, NULL, NULL, fault, systick},
    {uart0_received, NULL, uart1_received},
};

void machine_begin(void)
{
    TIMER_RELOAD = UINT32_MAX;
    TIMER_VALUE = UINT32_MAX;
    TIMER_CONTROL = 1;
}

uint32_t machine_instructions(void)
{
    uint64_t periods = UINT32_MAX - TIMER_VALUE;
    return (uint32_t)((periods * 40u + 32u) / 64u);
}

void machine_interrupt_in(uint32_t instructions, void (*handler)(void))
{
    interrupt = handler;
    SYSTICK_RELOAD = instructions * 64u / 40u + 1u;
    SYSTICK_VALUE = 0;
    SYSTICK_CONTROL = SYSTICK_RUNS;
}

void machine_interrupt_never(void)
{
    SYSTICK_CONTROL = 0;
    INTERRUPT_CONTROL = SYSTICK_CLEAR;
}

void machine_mask(void)
{
    __asm__ volatile("cpsid i" ::: "memory");
}

void machine_unmask(void)
{
    __asm__ volatile("cpsie i" ::: "memory");
}

uint32_t machine_stack(void)
{
    const uint32_t *word = &bss_end;
    while (word < &stack_top && *word == PAINT) {
        word++;
    }
    return (uint32_t)((const char *)&stack_top - (const char *)word);
}

void machine_print(const char *text)
{
    (void)semihost(SYS_WRITE0, text);
}

uint32_t machine_open(const char *name)
{
    uint32_t block[3] = {(uint32_t)name, MODE_WB, (uint32_t)strlen(name)};
    uint32_t file = semihost(SYS_OPEN, block);
    if (file == UINT32_MAX) {
        machine_print("cannot open the file\n");
        machine_exit(false);
    }
    return file;
}

/* The computer may take a part of the bytes; it returns how many are left. */
void machine_write(uint32_t file, const uint8_t *bytes, size_t size)
{
    while (size > 0) {
        uint32_t block[3] = {file, (uint32_t)bytes, (uint32_t)size};
        uint32_t left = semihost(SYS_WRITE, block);
        if (left >= size) {
            machine_print("cannot write to the file\n");
            machine_exit(false);
        }
        bytes += size - left;
        size = left;
    }
}

void machine_print_number(uint32_t value)
{
    char digits[11];
    char *digit = digits + sizeof digits - 1;
    *digit = '\0';
    do {
        *--digit = (char)('0' + value % 10u);
        value /= 10u;
    } while (value > 0);
    machine_print(digit);
}
