/* Spectrum frames, section 10: the sine and the amplitudes that all amplifiers share, the ramps of a
 * channel's envelope from frame to frame, and the sum over the carriers. Integers only. */
#ifndef TACTILE_SPECTRUM_H
#define TACTILE_SPECTRUM_H

#include "tactile_core.h"

/* Return 32767 sin and 32767 cos of an angle; a turn has 2^32 (10.1). */
int32_t ta_sine(uint32_t angle);
int32_t ta_cosine(uint32_t angle);

/* Returns the amplitude of a code, in 1/256 of a sample code: steps of 0.25 dB, 0 for code 0 (10.2). */
int32_t ta_amplitude(uint8_t code);

/* I and Q of an envelope, or cosine (i) and sine (q) of a carrier. */
typedef struct {
    int32_t i;
    int32_t q;
} ta_phasor;

/* Returns I and Q of an amplitude code and a phase code (10.2). */
ta_phasor ta_phasor_decode(uint8_t amplitude, uint8_t phase);

/* A frame in the queue, with the amplitude code and the phase code of each carrier. */
typedef struct {
    uint32_t position;
    uint16_t valid;
    uint8_t codes[2 * TA_CARRIERS];
} ta_frame;

/* The envelope of one channel (10.3). */
typedef struct {
    ta_phasor present[TA_CARRIERS];
    ta_phasor step[TA_CARRIERS]; /* change per position in a ramp */
    ta_frame target;             /* frame at which the ramp ends */
    bool ramping;
    uint8_t queued;
    uint32_t in_force; /* positions for which `present` is in force, this one included */
    ta_frame queue[TA_QUEUE];
} ta_envelope;

typedef enum { TA_FRAME_KEPT, TA_FRAME_LATE, TA_FRAME_FUTURE } ta_frame_fate;

void ta_envelope_clear(ta_envelope *e);

/* Queues a frame; `n` is the position that is put out next. With TA_FRAME_FUTURE this frame or the
 * last of the queue was dropped. */
ta_frame_fate ta_envelope_offer(ta_envelope *e, const ta_frame *frame, uint32_t n, uint32_t fifo);

/* Returns whether the channel is ready at n; `moved` says that n has changed since the last instant. */
bool ta_envelope_ready(const ta_envelope *e, uint32_t n, bool moved);

/* Goes on to position n by rules 1 to 3 of section 10.3. */
void ta_envelope_advance(ta_envelope *e, uint32_t n, bool moved, uint8_t carriers);

/* Stops the ramp, and drops frames whose position comes, in WAITING and STARVED. */
void ta_envelope_stop(ta_envelope *e, uint32_t n);
void ta_envelope_silence(ta_envelope *e);

/* Returns the sample code of an envelope (10.4); `turns` are the carriers at this position. */
int16_t ta_envelope_value(const ta_envelope *e, const ta_phasor *turns, uint8_t carriers);

#endif
