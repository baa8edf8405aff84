/* The sample formats of section 9: PCM16, PCM12 and BFP8. */
#ifndef TACTILE_SAMPLES_H
#define TACTILE_SAMPLES_H

#include "tactile_core.h"

#define TA_BFP8_BLOCK 32u /* samples that share an exponent */
#define TA_BFP8_EXPONENT_MAX 8u

/* The body of a PCM message and its layout. */
typedef struct {
    uint8_t format;
    uint8_t channels;
    uint8_t samples;
    const uint8_t *data;
} ta_samples;

/* Returns the number of bytes of the body, 0 for an unknown format. */
size_t ta_samples_size(uint8_t format, uint8_t channels, uint8_t samples);

/* Decodes one position of the body: a sample code, -32767 ... 32767, for each of its channels, of which there is
 * at least one. */
void ta_samples_row(const ta_samples *samples, uint8_t at, int16_t *codes);

/* Encodes channels x samples codes, position by position, into `out`, which has room for
 * ta_samples_size. It is in tactile_encode.c, for tests and hosts in firmware. */
void ta_samples_encode(const int16_t *codes, uint8_t format, uint8_t channels, uint8_t samples,
                       uint8_t *out);

#endif
