/* Correlations of measured currents with the drive that was played (16): the sums of the window under
 * way, and the entries of CORRELATION that follow from those of the window before.
 *
 * A sample costs TP_LAGS + 1 products of 16 bits per channel, added up in 64; the end of a window costs
 * up to TP_EXPONENT_MOST + 1 comparisons and TP_LAGS divisions by a power of 2 per channel.
 */
#ifndef TACTILE_CORRELATOR_H
#define TACTILE_CORRELATOR_H

#include "tactile_core.h"

#define TA_CODES (TP_LAGS + 1 + TA_CURRENT_DELAY)

/* Sums of a channel over a window. */
typedef struct {
    uint64_t energy;
    int64_t products[TP_LAGS + 1]; /* of the current with the code 0 ... TP_LAGS instants before */
    uint8_t flags;                 /* of its entry */
} ta_correlated;

typedef struct {
    uint32_t position; /* first of the window */
    uint16_t samples;
    uint16_t range_ua;
    ta_correlated sums[TA_CHANNELS];
} ta_window;

typedef struct {
    uint8_t channels;
    uint8_t newest;    /* place of the latest code in the rings */
    uint8_t delay;     /* instants by which the currents are late */
    uint8_t lacking;   /* instants until the first current that is of an instant after START */
    uint16_t left;     /* samples that the window under way still lacks, 0 if there is none */
    uint8_t open;      /* place of the window under way; the other is the one that is complete */
    bool complete;     /* a window is complete, and not sent yet */
    ta_window windows[2];
    int16_t codes[TA_CHANNELS][2 * TA_CODES]; /* rings of the codes put out last, twice: no reading wraps */
} ta_correlator;

/* Forgets the codes that were played and the window under way, as at START. */
void ta_correlator_start(ta_correlator *c, uint8_t channels, uint8_t delay);

/* Ends the window under way, which is not sent. */
void ta_correlator_stop(ta_correlator *c);

/* Adds the codes that were put out at an instant of RUNNING; returns whether the current that is known
 * now is of an instant after START. */
bool ta_correlator_played(ta_correlator *c, const int16_t *codes);

/* Returns the code of a channel that the current belongs to that is known now; older ones are before it. */
const int16_t *ta_correlator_code(const ta_correlator *c, size_t channel);

/* Begins a window of `samples` if none is under way, with the instant whose current is known when
 * `position` has been put out. */
void ta_correlator_open(ta_correlator *c, uint32_t position, uint16_t samples, uint16_t range_ua);

/* Notes that a guard holds a channel down now, in a window that is open. */
void ta_correlator_held(ta_correlator *c, size_t channel);

typedef enum {
    TA_WINDOW_LACKS,    /* the window lacks samples, or there is none */
    TA_WINDOW_COMPLETE, /* it is complete; it stays until ta_correlator_sent */
    TA_WINDOW_LOST      /* it is complete and is lost, since the one before has not been sent */
} ta_window_fate;

/* Adds the current codes that are known now to the window under way. */
ta_window_fate ta_correlator_add(ta_correlator *c, const int16_t *currents);

/* Returns the window that is complete. */
const ta_window *ta_correlator_window(const ta_correlator *c);

/* Frees the window that is complete. */
void ta_correlator_sent(ta_correlator *c);

/* Writes the entry of a channel, TA_ENTRY bytes. */
void ta_correlator_entry(const ta_correlated *s, uint8_t *out);

#endif
