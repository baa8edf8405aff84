/* Eight channels of 12 bits (Analog Devices AD5672R, revision D). With RSTSEL high its outputs are in the middle
 * of their range at reset, which the amplifier behind it makes 0 V. */
#ifndef AD5672R_H
#define AD5672R_H

#include <stddef.h>
#include <stdint.h>

#define AD5672R_CHANNELS 8u
#define AD5672R_LOAD 1u /* command: write the input register, which LDAC latches */

/* Returns the 24 bits that load a code: command, address, and 12 bits to the left of 16. */
static inline uint32_t ad5672r_word(size_t channel, int16_t code)
{
    uint32_t steps = (uint32_t)(code + 32768) >> 4;
    return AD5672R_LOAD << 20 | (uint32_t)(channel % AD5672R_CHANNELS) << 16 | steps << 4;
}

#endif
