/* The serial lines UART0 and UART1 of mps2-an385 and mps2-an386: received bytes wait in a ring that an interrupt
 * fills, so that none is lost while the program is busy. */
#ifndef UART_H
#define UART_H

#include <stddef.h>
#include <stdint.h>

typedef enum { UART0, UART1 } uart_line;

/* Starts both lines. */
void uart_begin(void);

/* Waits for `size` bytes. */
void uart_read(uart_line line, uint8_t *bytes, size_t size);

/* Waits until the line has taken all bytes. */
void uart_write(uart_line line, const uint8_t *bytes, size_t size);

#endif
