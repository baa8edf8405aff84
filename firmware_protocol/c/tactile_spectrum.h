/* Spectrum frames, section 10: the sine and the amplitudes that all amplifiers share, the ramps of a
 * channel's envelope from frame to frame, and the sum over the carriers. Integers only. */
#ifndef TACTILE_SPECTRUM_H
#define TACTILE_SPECTRUM_H

#include "tactile_core.h"

/* Returns the amplitude of a code, in 1/256 of a sample code: steps of 0.25 dB, 0 for code 0 (10.2). */
int32_t ta_amplitude(uint8_t code);

/* I and Q of an envelope, or what they are multiplied with at an angle of a carrier. */
typedef struct {
    int32_t i;
    int32_t q;
} ta_phasor;

/* Returns 32767 cos (i) and -32767 sin (q) of an angle; a turn has 2^32 (10.1). */
ta_phasor ta_turn(uint32_t angle);

/* Returns I and Q of an amplitude code and a phase code (10.2). */
ta_phasor ta_phasor_decode(uint8_t amplitude, uint8_t phase);

/* A frame, with the envelope of each carrier. */
typedef struct {
    uint32_t position;
    uint16_t valid;
    ta_phasor phasors[TA_CARRIERS];
} ta_frame;

/* The envelope of one channel (10.3). Frames stay where they are; their order is that of `order`. */
typedef struct {
    ta_phasor present[TA_CARRIERS];
    ta_phasor step[TA_CARRIERS]; /* change per position in a ramp */
    bool ramping;
    uint8_t queued;
    uint32_t in_force; /* positions for which `present` is in force, this one included */
    uint8_t order[TA_QUEUE + 1]; /* the frame at which the ramp ends, those of the queue, free ones */
    ta_frame frames[TA_QUEUE + 1];
} ta_envelope;

typedef enum { TA_FRAME_KEPT, TA_FRAME_LATE, TA_FRAME_FUTURE } ta_frame_fate;

void ta_envelope_clear(ta_envelope *e);

/* Gives a free place for the frame of `position`, to be decoded and then kept; `n` is the position that is put out
 * next. *frame becomes NULL if the frame is dropped, or is there already. With TA_FRAME_FUTURE this frame or the
 * last of the queue was dropped. */
ta_frame_fate ta_envelope_offer(ta_envelope *e, uint32_t position, uint32_t n, uint32_t fifo,
                                ta_frame **frame);

/* Decodes a frame, with an amplitude code and a phase code of each carrier, to the place that was offered. */
void ta_frame_decode(ta_frame *frame, uint16_t valid, const uint8_t *codes, uint8_t carriers);

/* Queues the frame that was decoded, if its position has not come meanwhile. */
ta_frame_fate ta_envelope_keep(ta_envelope *e, const ta_frame *frame, uint32_t n);

/* Returns whether a channel is ready at position n; `moved` says whether n has changed since the last
 * instant. */
bool ta_envelope_ready(const ta_envelope *e, uint32_t n, bool moved);

/* Carries out steps 1 to 3 for position n, and returns the value there (10.4), with the turns of the
 * carriers at n. */
int16_t ta_envelope_next(ta_envelope *e, uint32_t n, bool moved, const ta_phasor *turns,
                         uint8_t carriers);

/* Drops the ramp and the frames whose position has come, where no ramp may begin: WAITING, STARVED. */
void ta_envelope_stop(ta_envelope *e, uint32_t n);

/* Sets the present envelope to 0. */
void ta_envelope_silence(ta_envelope *e);

/* Returns the value of the present envelope (10.4). */
int16_t ta_envelope_value(const ta_envelope *e, const ta_phasor *turns, uint8_t carriers);

#endif
