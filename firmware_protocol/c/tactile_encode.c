/* The encoder of the sample formats, apart from their decoder: amplifiers do without it. */
#include "tactile_samples.h"

#define BLOCK TA_BFP8_BLOCK
#define EXPONENT_MAX TA_BFP8_EXPONENT_MAX

/* value / 2^bits to the nearest, halves up. */
static int32_t rounded(int32_t value, unsigned bits)
{
    int32_t half = bits > 0 ? (int32_t)1 << (bits - 1u) : 0;
    return (int32_t)ta_shift_right(value + half, bits);
}

static void pcm12_put(uint8_t *data, size_t index, int32_t code)
{
    uint8_t *pair = data + index / 2u * 3u;
    uint32_t v = (uint32_t)ta_clamp(rounded(code, 4), 2047) & 0xFFFu;
    if (index % 2u == 0) {
        pair[0] = (uint8_t)v;
        pair[1] = (uint8_t)(v >> 8);
    } else {
        pair[1] = (uint8_t)(pair[1] | v << 4);
        pair[2] = (uint8_t)(v >> 4);
    }
}

/* One block of one channel; codes are `stride` apart. At exponent 8 the codes from 32640 on would
 * give 128: they are held at 127. */
static void bfp8_block(const int16_t *codes, size_t stride, size_t count, uint8_t *out)
{
    uint8_t exponent = 0;
    for (size_t i = 0; i < count; i++) {
        while (exponent < EXPONENT_MAX &&
               ta_clamp(rounded(codes[i * stride], exponent), 127) !=
                   rounded(codes[i * stride], exponent)) {
            exponent++;
        }
    }
    out[0] = exponent;
    for (size_t i = 0; i < count; i++) {
        out[1u + i] = (uint8_t)ta_clamp(rounded(codes[i * stride], exponent), 127);
    }
}

static void bfp8_encode(const int16_t *codes, uint8_t channels, uint8_t samples, uint8_t *out)
{
    for (size_t c = 0; c < channels; c++) {
        for (size_t at = 0; at < samples; at += BLOCK) {
            size_t count = samples - at < BLOCK ? samples - at : BLOCK;
            bfp8_block(codes + at * channels + c, channels, count, out);
            out += count + 1u;
        }
    }
}

void ta_samples_encode(const int16_t *codes, uint8_t format, uint8_t channels, uint8_t samples,
                       uint8_t *out)
{
    size_t count = (size_t)channels * samples;
    if (format == TP_SAMPLE_FORMAT_BFP8) {
        bfp8_encode(codes, channels, samples, out);
        return;
    }
    for (size_t i = 0; i < count; i++) {
        if (format == TP_SAMPLE_FORMAT_PCM12) {
            pcm12_put(out, i, codes[i]);
        } else {
            tp_put_le(out + 2u * i, (uint64_t)(uint16_t)codes[i], 2);
        }
    }
}
