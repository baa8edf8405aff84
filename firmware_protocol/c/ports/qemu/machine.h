/* What the programs in this folder need of a machine of QEMU: a counter of instructions, output, and an
 * end. QEMU's option -icount shift=6 lets each instruction take 64 ns of virtual time, and a timer at
 * 25 MHz, 40 ns, tells that time: counts are exact to an instruction and the same in every run. */
#ifndef MACHINE_H
#define MACHINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Starts the counter. */
void machine_begin(void);

/* Returns the number of instructions since machine_begin, modulo 2^26. */
#define MACHINE_COUNT_MASK 0x3FFFFFFu
uint32_t machine_instructions(void);

/* Calls `handler` as an interrupt after so many instructions, at most 10 million, once. */
void machine_interrupt_in(uint32_t instructions, void (*handler)(void));

/* Calls off an interrupt that has not come yet. */
void machine_interrupt_never(void);

/* Hold off that interrupt, and allow it again. */
void machine_mask(void);
void machine_unmask(void);

/* Writes text to the standard output of QEMU. */
void machine_print(const char *text);
void machine_print_number(uint32_t value);

/* Opens a file of the computer for writing. */
uint32_t machine_open(const char *name);
void machine_write(uint32_t file, const uint8_t *bytes, size_t size);

/* Ends QEMU. */
void machine_exit(bool good);

/* Returns the largest number of bytes of the stack that were in use since power-up. */
uint32_t machine_stack(void);

#endif
