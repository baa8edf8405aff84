/* Functions that the files of the amplifier share: tactile_amplifier.c acts unasked, tactile_requests.c
 * checks requests and answers them, tactile_actions.c and tactile_settings.c carry them out. */
#ifndef TACTILE_INTERNAL_H
#define TACTILE_INTERNAL_H

#include "tactile_amplifier.h"

/* Applies an entry of the table of section 6: the state that follows, or that which follows RAMPDOWN. */
void ta_apply(ta_amplifier *amp, uint8_t entry);

/* Puts limits in force, for the player as well. */
void ta_limit(ta_amplifier *amp, uint32_t voltage_uv, uint32_t slew_v_per_s, uint32_t fade_us);

/* Returns a voltage in sample codes, at most full scale (11.1). */
int32_t ta_limit_codes(const ta_config *c, uint32_t voltage_uv);

/* Returns whether limits reach 0 V in 20 ms at a rate (11.1). */
bool ta_reach_zero(const ta_config *c, uint32_t voltage_uv, uint32_t slew_v_per_s, uint32_t rate);

/* Sets the sample rate for ARM; another rate begins at `now`. */
void ta_set_rate(ta_amplifier *amp, uint32_t rate, uint64_t now);

/* Hold off ta_run around what it must not interrupt, for no longer than an instant takes. They do not nest. */
static inline void ta_lock(const ta_amplifier *amp)
{
    if (amp->hal.mask != NULL) {
        amp->hal.mask(amp->hal.context);
    }
}

static inline void ta_unlock(const ta_amplifier *amp)
{
    if (amp->hal.mask != NULL) {
        amp->hal.unmask(amp->hal.context);
    }
}

/* Carries out the instants up to `now`, in firmware in which no interrupt does. */
void ta_catch_up(ta_amplifier *amp, uint64_t now);

/* Sends a packet whose payload is at packet + TA_HEADER. */
void ta_send(ta_amplifier *amp, uint8_t type, uint8_t *packet, size_t payload_size);

/* Note what ta_serve is to send. They are called by ta_run, or within a lock. */
void ta_note_pulse(ta_amplifier *amp);
void ta_note_log(ta_amplifier *amp, uint8_t level, const char *text, uint8_t fault); /* NULL: of the fault */
void ta_note_sense(ta_amplifier *amp);
void ta_note_correlation(ta_amplifier *amp);
void ta_note_guarded(ta_amplifier *amp, uint32_t position);
void ta_note_marked(ta_amplifier *amp, uint32_t position);

/* Notes PULSE if the state has changed since the last call. */
void ta_announce(ta_amplifier *amp);

/* Returns whether the e-stop input counts as open (6.3). */
bool ta_input_open(const ta_amplifier *amp, uint64_t now);

/* CORRELATION (16): whether the board has it, what START forgets, and the end of the window under way. */
bool ta_correlates(const ta_amplifier *amp);
void ta_correlation_start(ta_amplifier *amp);
void ta_correlation_stop(ta_amplifier *amp);

/* Returns whether the board has marker lines (18). */
static inline bool ta_has_markers(const ta_amplifier *amp)
{
    return TA_MARKER_LINES != 0 && amp->config.marker_lines != 0;
}

/* Returns the phase that the host is told, which is STILL except in RUNNING. */
uint8_t ta_phase(const ta_amplifier *amp);

/* A message that was received. */
typedef struct {
    ta_packet packet;
    uint64_t now;
    bool to_all; /* addressed to node 0 */
    bool ack;    /* the host wants an answer */
} ta_request;

/* The result of a request: TA_DONE, or the code of NAK. */
typedef uint8_t ta_verdict;
#define TA_DONE 0u

/* Count a refusal, and keep the detail of its NAK. */
ta_verdict ta_refuse_as(ta_amplifier *amp, uint32_t *counter, uint8_t code, uint32_t detail);
ta_verdict ta_refuse(ta_amplifier *amp, uint8_t code, uint32_t detail); /* as refused */
ta_verdict ta_malformed(ta_amplifier *amp, const ta_request *r);

/* Makes check 8: whether the table allows the event in this state. */
ta_verdict ta_by_table(ta_amplifier *amp, const uint8_t *table);

/* Rows of the table of section 6, with an entry per state. */
extern const uint8_t ta_on_arm[], ta_on_start[], ta_on_stop[], ta_on_disarm[], ta_on_estop[],
    ta_on_clear_fault[], ta_on_limits[], ta_on_carriers[];

/* Each makes check 9 of a message and carries it out. Those of which a rule (tactile_requests.c) says so are called
 * within a lock, after check 8; the others take it themselves, for no more than they must. */
ta_verdict ta_act_hello(ta_amplifier *amp, const ta_request *r);
ta_verdict ta_act_time(ta_amplifier *amp, const ta_request *r);
ta_verdict ta_act_sync(ta_amplifier *amp, const ta_request *r);
ta_verdict ta_act_start(ta_amplifier *amp, const ta_request *r);
ta_verdict ta_act_stop(ta_amplifier *amp, const ta_request *r);
ta_verdict ta_act_arm(ta_amplifier *amp, const ta_request *r);
ta_verdict ta_act_disarm(ta_amplifier *amp, const ta_request *r);
ta_verdict ta_act_estop(ta_amplifier *amp, const ta_request *r);
ta_verdict ta_act_clear_fault(ta_amplifier *amp, const ta_request *r);
ta_verdict ta_act_heartbeat(ta_amplifier *amp, const ta_request *r);
ta_verdict ta_act_limits(ta_amplifier *amp, const ta_request *r);
ta_verdict ta_act_get(ta_amplifier *amp, const ta_request *r);
ta_verdict ta_act_set(ta_amplifier *amp, const ta_request *r);
ta_verdict ta_act_identify(ta_amplifier *amp, const ta_request *r);
ta_verdict ta_act_poll(ta_amplifier *amp, const ta_request *r);
ta_verdict ta_act_pcm(ta_amplifier *amp, const ta_request *r);
ta_verdict ta_act_carriers(ta_amplifier *amp, const ta_request *r);
ta_verdict ta_act_guard(ta_amplifier *amp, const ta_request *r);
ta_verdict ta_act_spectrum(ta_amplifier *amp, const ta_request *r);
ta_verdict ta_act_mark(ta_amplifier *amp, const ta_request *r);

void ta_send_caps(ta_amplifier *amp);

#endif
