/* Spectrum frames, section 10: the sine and the amplitudes that all amplifiers share, the ramps of a
 * channel's envelope from frame to frame, and the sum over the carriers. Integers only. */
#ifndef TACTILE_SPECTRUM_H
#define TACTILE_SPECTRUM_H

#include "tactile_core.h"

/* 32767 sin and cos of an angle, 2^32 to the turn (10.1). */
int32_t ta_sine(uint32_t angle);
int32_t ta_cosine(uint32_t angle);

/* 0.25 dB steps, in 1/256 of a sample code; 0 for code 0 (10.2). */
int32_t ta_amplitude(uint8_t code);

/* An envelope or, of a carrier, its cosine (i) and sine (q). */
typedef struct {
    int32_t i;
    int32_t q;
} ta_phasor;

/* I and Q of an amplitude code and a phase code (10.2). */
ta_phasor ta_phasor_decode(uint8_t amplitude, uint8_t phase);

/* A frame as it waits: for each carrier amplitude code and phase code. */
typedef struct {
    uint32_t position;
    uint16_t valid;
    uint8_t codes[2 * TA_CARRIERS];
} ta_frame;

/* The envelope of one channel (10.3). */
typedef struct {
    ta_phasor present[TA_CARRIERS];
    ta_phasor step[TA_CARRIERS]; /* per position, while ramping */
    ta_frame target;             /* where the ramp ends */
    bool ramping;
    uint8_t queued;
    uint32_t in_force; /* positions, the present one included */
    ta_frame queue[TA_QUEUE];
} ta_envelope;

typedef enum { TA_FRAME_KEPT, TA_FRAME_LATE, TA_FRAME_FUTURE } ta_frame_fate;

void ta_envelope_clear(ta_envelope *e);

/* Takes a frame; `n` is the position that is put out next. FUTURE: one is dropped, this or another. */
ta_frame_fate ta_envelope_offer(ta_envelope *e, const ta_frame *frame, uint32_t n, uint32_t fifo);

/* Whether the channel is ready at n, which `moved` from the position before or is the same. */
bool ta_envelope_ready(const ta_envelope *e, uint32_t n, bool moved);

/* Goes on to n: steps 1 to 3. */
void ta_envelope_advance(ta_envelope *e, uint32_t n, bool moved, uint8_t carriers);

/* WAITING and STARVED: the ramp stops, and frames whose position comes are dropped. */
void ta_envelope_stop(ta_envelope *e, uint32_t n);
void ta_envelope_silence(ta_envelope *e);

/* The sample code of an envelope (10.4); `turns` are the carriers at this position. */
int16_t ta_envelope_value(const ta_envelope *e, const ta_phasor *turns, uint8_t carriers);

#endif
