/* Sample formats: every body of up to TA_CHANNELS channels, with arbitrary bytes. */
#include "../tactile_samples.h"
#include "proof.h"

#define MOST 255u
#define BLOCK 32u

/* Rows `at` of a body, which ends where its array ends: a byte read too far is an alarm. The same holds for
 * the codes. */
static void decode(const ta_samples *kind, uint8_t at)
{
    uint8_t bytes[2u * TA_CHANNELS * MOST];
    int16_t codes[TA_CHANNELS];
    ta_samples s = *kind;
    int16_t *first = codes + TA_CHANNELS - s.channels;
    ANY(bytes);
    s.data = bytes + sizeof bytes - ta_samples_size(s.format, s.channels, s.samples);
    ta_samples_row(&s, at, first);
    for (size_t c = 0; c < s.channels; c++) {
        //@ check -32767 <= first[c] <= 32767;
    }
}

/* What is read of PCM16 and PCM12 depends on the row, not on the number of rows, so that the last row of each
 * body stands for all; of BFP8 it depends on both. */
static void decode_rows(const ta_samples *kind)
{
    if (kind->format != TP_SAMPLE_FORMAT_BFP8) {
        decode(kind, (uint8_t)(kind->samples - 1u));
        return;
    }
    for (uint32_t at = 0; at < kind->samples; at += BLOCK) {
        uint32_t last = kind->samples - at < BLOCK ? kind->samples - 1u : at + BLOCK - 1u;
        decode(kind, Frama_C_unsigned_char_interval((uint8_t)at, (uint8_t)last));
    }
}

int main(void)
{
    for (uint8_t format = TP_SAMPLE_FORMAT_PCM16; format <= TP_SAMPLE_FORMAT_BFP8; format++) {
        for (uint8_t channels = 1; channels <= TA_CHANNELS; channels++) {
            for (uint32_t samples = 1; samples <= MOST; samples++) {
                ta_samples kind = {format, channels, (uint8_t)samples, NULL};
                decode_rows(&kind);
            }
        }
    }
    return 0;
}
