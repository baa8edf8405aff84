/* Conversion of a stream into codes, instant by instant: the buffer (8.1), phases and bridges (8.2), the
 * gain (8.3), spectrum envelopes (10.3) and the last stage (11.2), which bounds every sample.
 *
 * The player knows neither sessions nor packets nor time: the amplifier passes it the state, and calls
 * it once at each instant.
 */
#ifndef TACTILE_PLAYER_H
#define TACTILE_PLAYER_H

#include "tactile_samples.h"
#include "tactile_spectrum.h"

/* A straight line between two samples of a channel, over those that are missing (8.2). */
typedef struct {
    int16_t from;
    int16_t to;
    uint16_t length; /* steps of the bridge */
    uint16_t done;
} ta_bridge;

typedef struct {
    ta_counters *counters;
    uint8_t channels;
    uint8_t mode;
    uint8_t phase; /* phase of RUNNING; the RAMPDOWN that follows plays on by it */
    uint8_t carriers;
    bool quick;     /* RAMPDOWN at the slew limit */
    bool moved;     /* the position has changed since the last instant */
    bool starving;  /* there is an underrun at this instant */
    bool silent;    /* all codes are 0 */
    bool held_down; /* some gain of `held` may be below TA_GAIN_FULL */
    uint16_t fifo;
    uint16_t head; /* row of the buffer that holds `position` */
    uint16_t fill; /* number of positions from `position` to the newest sample or frame */
    uint32_t rate;
    uint32_t position;  /* position that is put out next */
    uint32_t gain;      /* g of section 8.3 */
    uint32_t gain_full; /* N of section 8.3 */
    int32_t limit;
    int32_t step;
    uint32_t increments[TA_CARRIERS];
    int16_t codes[TA_CHANNELS];  /* codes that were put out last */
    int32_t held[TA_CHANNELS];   /* gains of the guards (17.4), of TA_GAIN_FULL */
    int16_t values[TA_CHANNELS]; /* last values, before the gain */
    ta_set active;               /* channels of which something was kept since START (8.2) */
    ta_set bridging;             /* channels with a bridge under way */
    ta_bridge bridges[TA_CHANNELS];
    ta_set present[TA_FIFO]; /* channels that have a sample in each row of the buffer */
    union {                  /* a stream is of one mode, so that both share the memory */
        int16_t samples[TA_FIFO][TA_CHANNELS];
        ta_envelope envelopes[TA_CHANNELS];
    } kept;
} ta_player;

void ta_player_init(ta_player *p, ta_counters *counters, uint8_t channels, uint16_t fifo);

/* Empties the buffer before a START: no channel is active. Instants of states that do not play, neither RUNNING
 * nor RAMPDOWN, may come meanwhile. */
void ta_player_clear(ta_player *p);

/* Begins a START, with the buffer cleared: the gain is 0, the phase WAITING. */
void ta_player_start(ta_player *p, uint32_t position);

/* Stores of samples and frames that have passed all checks. Each takes two calls, so that it can be decoded
 * between them, where instants may come; what comes too late even then is counted and not kept. */

/* Returns the row for the samples of a position, to write those of some channels to; NULL if it is late or in
 * the future, which is counted. */
int16_t *ta_player_row(ta_player *p, uint32_t position);

/* Keeps the samples of these channels that were written to the row of a position. */
void ta_player_keep_row(ta_player *p, uint32_t position, const ta_set *channels);

/* Returns a place for the frame of a position, to decode it to; NULL if it is late, in the future or there
 * already, of which the first two are counted. */
ta_frame *ta_player_frame(ta_player *p, size_t channel, uint32_t position);

/* Keeps a frame that was decoded, and holds its validity to TP_VALID_MS. */
void ta_player_keep_frame(ta_player *p, size_t channel, ta_frame *frame);

/* Carries out an instant: settles phase and gain and puts the new codes into `codes`. `come` says that
 * the tick of START has come, so that WAITING may end. */
void ta_player_instant(ta_player *p, uint8_t state, bool come);

/* Goes on to the next position after an instant; `hold` keeps the position while START is pending. */
void ta_player_move(ta_player *p, bool hold);

/* Goes on to the next position without carrying out the instant: the codes stay, and what played is in an
 * underrun (7.1). */
void ta_player_skip(ta_player *p, uint8_t state, bool hold);

#endif
