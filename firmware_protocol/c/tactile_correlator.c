/* Correlations; see the header. */
#include "tactile_correlator.h"

#define PLACES (TP_LAGS + 1u)
#define CODE_BITS 15u   /* of a correlation in its entry, without the sign */
#define ENERGY_BITS 10u /* of the energy in its entry */

void ta_correlator_start(ta_correlator *c, uint8_t channels, uint8_t delay)
{
    memset(c, 0, sizeof *c);
    c->channels = channels;
    c->delay = delay;
    c->lacking = delay;
}

void ta_correlator_stop(ta_correlator *c)
{
    c->left = 0;
}

bool ta_correlator_played(ta_correlator *c, const int16_t *codes)
{
    c->newest = (uint8_t)(c->newest + 1u < TA_CODES ? c->newest + 1u : 0);
    for (size_t i = 0; i < c->channels; i++) {
        c->codes[i][c->newest] = codes[i];
        c->codes[i][c->newest + TA_CODES] = codes[i];
    }
    if (c->lacking > 0) {
        c->lacking--;
        return false;
    }
    return true;
}

void ta_correlator_open(ta_correlator *c, uint32_t position, uint16_t samples, uint16_t range_ua)
{
    ta_window *window = &c->windows[c->open];
    if (c->left > 0) {
        return;
    }
    window->position = position - c->delay;
    window->samples = samples;
    window->range_ua = range_ua;
    c->left = samples;
    for (size_t i = 0; i < c->channels; i++) {
        ta_correlated *s = &window->sums[i];
        s->energy = 0;
        s->flags = 0;
        memset(s->products, 0, sizeof s->products);
    }
}

const int16_t *ta_correlator_code(const ta_correlator *c, size_t channel)
{
    return c->codes[channel] + c->newest + TA_CODES - c->delay;
}

/* Adds a current, and its products with the code it belongs to and those before. */
static void add(ta_correlated *s, const int16_t *code, int32_t current)
{
    int64_t *product = s->products;
    const int64_t *end = product + PLACES;
    do {
        *product++ += current * *code--;
    } while (product < end);
    s->energy += (uint64_t)(current * current);
    if (current == (int32_t)TP_FULL_SCALE_CODE || current == -(int32_t)TP_FULL_SCALE_CODE) {
        s->flags |= TP_WINDOW_CLIPPED;
    }
}

void ta_correlator_held(ta_correlator *c, size_t channel)
{
    c->windows[c->open].sums[channel].flags |= TP_WINDOW_GUARDED;
}

ta_window_fate ta_correlator_add(ta_correlator *c, const int16_t *currents)
{
    ta_correlated *sums = c->windows[c->open].sums;
    if (c->left == 0) {
        return TA_WINDOW_LACKS;
    }
    for (size_t i = 0; i < c->channels; i++) {
        add(&sums[i], ta_correlator_code(c, i), currents[i] == INT16_MIN ? -INT16_MAX : currents[i]);
    }
    c->left--;
    if (c->left > 0) {
        return TA_WINDOW_LACKS;
    }
    if (c->complete) {
        return TA_WINDOW_LOST;
    }
    c->complete = true;
    c->open ^= 1u;
    return TA_WINDOW_COMPLETE;
}

const ta_window *ta_correlator_window(const ta_correlator *c)
{
    return &c->windows[c->open ^ 1u];
}

void ta_correlator_sent(ta_correlator *c)
{
    c->complete = false;
}

/* The least exponent with which a value has so many bits, not rounded. */
static unsigned exponent_for(uint64_t value, unsigned bits)
{
    unsigned exponent = 0;
    for (; value >> bits != 0; value >>= 1) {
        exponent++;
    }
    return exponent;
}

/* The least exponent with which all correlations fit 16 bits. Rounding may need one more than their bits say. */
static unsigned exponent_of(const int64_t *sums)
{
    int64_t high = sums[0];
    int64_t low = sums[0];
    for (size_t lag = 1; lag < TP_LAGS; lag++) {
        high = sums[lag] > high ? sums[lag] : high;
        low = sums[lag] < low ? sums[lag] : low;
    }
    unsigned exponent = exponent_for((uint64_t)(high > -low ? high : -low), CODE_BITS);
    bool fits = ta_rounded(high, exponent) <= INT16_MAX && ta_rounded(low, exponent) >= -INT16_MAX;
    return fits ? exponent : exponent + 1u;
}

static uint32_t energy_code(uint64_t energy)
{
    unsigned exponent = exponent_for(energy, ENERGY_BITS);
    exponent += (uint64_t)ta_rounded((int64_t)energy, exponent) >> ENERGY_BITS != 0 ? 1u : 0u;
    return exponent << ENERGY_BITS | (uint32_t)ta_rounded((int64_t)energy, exponent);
}

void ta_correlator_entry(const ta_correlated *s, uint8_t *out)
{
    int64_t sums[TP_LAGS];
    for (size_t lag = 0; lag < TP_LAGS; lag++) {
        sums[lag] = s->products[lag] - s->products[lag + 1u];
    }
    unsigned exponent = exponent_of(sums);
    out[0] = s->flags;
    out[1] = (uint8_t)exponent;
    tp_put_le(out + 2, energy_code(s->energy), 2);
    for (size_t lag = 0; lag < TP_LAGS; lag++) {
        tp_put_le(out + 4u + 2u * lag, (uint64_t)ta_rounded(sums[lag], exponent), 2);
    }
}
