/* SPI of several parts (Arm PrimeCell PL022, DDI 0194). */
#ifndef PL022_H
#define PL022_H

#include <stdint.h>

typedef struct {
    volatile uint32_t cr0;
    volatile uint32_t cr1;
    volatile uint32_t dr;
    volatile uint32_t sr;
    volatile uint32_t cpsr;
} pl022;

#define PL022_CR0_12_BITS 11u
#define PL022_CR0_SPH (1u << 7) /* the DAC takes a bit at the second edge of its clock */
#define PL022_CR1_SSE (1u << 1)
#define PL022_SR_RNE (1u << 2)
#define PL022_SR_BSY (1u << 4)

/* Starts with a bit rate of the clock / `divider`, which is even. */
static inline void pl022_begin(pl022 *spi, uint32_t divider)
{
    spi->cr1 = 0;
    spi->cpsr = divider;
    spi->cr0 = PL022_CR0_12_BITS | PL022_CR0_SPH;
    spi->cr1 = PL022_CR1_SSE;
}

/* Sends 24 bits, and returns when the last one is out. */
static inline void pl022_write(pl022 *spi, uint32_t word)
{
    spi->dr = word >> 12;
    spi->dr = word & 0xFFFu;
    while ((spi->sr & PL022_SR_BSY) != 0) {
    }
    while ((spi->sr & PL022_SR_RNE) != 0) {
        (void)spi->dr;
    }
}

#endif
