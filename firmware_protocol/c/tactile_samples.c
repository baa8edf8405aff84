/* Sample formats; see the header. */
#include "tactile_samples.h"

#define BLOCK TA_BFP8_BLOCK
#define EXPONENT_MAX TA_BFP8_EXPONENT_MAX
#define FULL_SCALE ((int32_t)TP_FULL_SCALE_CODE)

size_t ta_samples_size(uint8_t format, uint8_t channels, uint8_t samples)
{
    size_t count = (size_t)channels * samples;
    switch (format) {
    case TP_SAMPLE_FORMAT_PCM16:
        return 2u * count;
    case TP_SAMPLE_FORMAT_PCM12:
        return (3u * count + 1u) / 2u;
    case TP_SAMPLE_FORMAT_BFP8:
        return channels * (samples + (samples + BLOCK - 1u) / BLOCK);
    default:
        return 0;
    }
}

/* Two's complement of `bits` bits. */
static int32_t extend(uint32_t value, unsigned bits)
{
    int32_t half = (int32_t)1 << (bits - 1u);
    return (int32_t)(value ^ (uint32_t)half) - half;
}

static void pcm16_row(const uint8_t *data, size_t channels, int16_t *codes)
{
    const int16_t *end = codes + channels;
    do {
        int32_t value = extend((uint32_t)data[0] | (uint32_t)data[1] << 8, 16);
        *codes++ = (int16_t)(value < -FULL_SCALE ? -FULL_SCALE : value);
        data += 2;
    } while (codes < end);
}

/* Three bytes hold two samples; a row begins in the middle of them where `index` is odd. */
static void pcm12_row(const uint8_t *data, size_t index, size_t channels, int16_t *codes)
{
    const uint8_t *pair = data + index / 2u * 3u;
    bool second = index % 2u != 0;
    for (size_t c = 0; c < channels; c++) {
        uint32_t value = second ? (uint32_t)pair[1] >> 4 | (uint32_t)pair[2] << 4
                                : pair[0] | (pair[1] & 0x0Fu) << 8;
        codes[c] = (int16_t)(16 * ta_clamp(extend(value, 12), 2047));
        pair += second ? 3 : 0;
        second = !second;
    }
}

/* `data`: the blocks of the first channel, of `line` bytes as those of each channel. */
static void bfp8_row(const uint8_t *data, size_t line, uint8_t at, size_t channels, int16_t *codes)
{
    const uint8_t *block = data + at / BLOCK * (BLOCK + 1u);
    for (size_t c = 0; c < channels; c++) {
        unsigned exponent = block[0] < EXPONENT_MAX ? block[0] : EXPONENT_MAX;
        int32_t value = extend(block[1u + at % BLOCK], 8) * ((int32_t)1 << exponent);
        codes[c] = (int16_t)(value < -FULL_SCALE ? -FULL_SCALE : value);
        block += line;
    }
}

void ta_samples_row(const ta_samples *s, uint8_t at, int16_t *codes)
{
    size_t index = (size_t)at * s->channels;
    switch (s->format) {
    case TP_SAMPLE_FORMAT_PCM16:
        pcm16_row(s->data + 2u * index, s->channels, codes);
        break;
    case TP_SAMPLE_FORMAT_PCM12:
        pcm12_row(s->data, index, s->channels, codes);
        break;
    default:
        bfp8_row(s->data, ta_samples_size(s->format, 1, s->samples), at, s->channels, codes);
        break;
    }
}
