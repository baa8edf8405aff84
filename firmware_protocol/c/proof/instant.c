/* Contracts of an instant. The steps before the last stage change neither codes nor limits, and keep the gain
 * within its range, so that what last_stage.c proves holds of every instant. */
#include "player.h"

/*@ lemma most_ends: most(32) == 0; */

/*@ predicate in_range(ta_player *p) =
      set_up(p) && p->gain <= p->gain_full && p->carriers <= TA_CARRIERS &&
      p->head < p->fifo <= TA_FIFO && p->fill <= p->fifo; */

/*@ requires \valid_read(set);
    assigns \nothing; */
static bool ta_set_empty(const ta_set *set);

/*@ requires \valid_read(set) && channel < 32 * TA_WORDS;
    assigns \nothing; */
static bool ta_set_has(const ta_set *set, size_t channel);

/*@ requires \valid(set) && channel < 32 * TA_WORDS;
    assigns *set; */
static void ta_set_remove(ta_set *set, size_t channel);

/*@ requires \valid(set) && \valid_read(less);
    assigns *set; */
static void ta_set_subtract(ta_set *set, const ta_set *less);

/*@ assigns \nothing; */
ta_phasor ta_turn(uint32_t angle);

/*@ requires \valid_read(e);
    assigns \nothing; */
bool ta_envelope_ready(const ta_envelope *e, uint32_t n, bool moved);

/*@ requires \valid(e);
    assigns *e; */
void ta_envelope_stop(ta_envelope *e, uint32_t n);

/*@ requires \valid(e);
    assigns *e; */
void ta_envelope_silence(ta_envelope *e);

/*@ requires \valid(e) && \valid_read(turns + (0 .. carriers - 1));
    assigns *e; */
int16_t ta_envelope_next(ta_envelope *e, uint32_t n, bool moved, const ta_phasor *turns, uint8_t carriers);

/*@ requires \valid_read(e) && \valid_read(turns + (0 .. carriers - 1));
    assigns \nothing; */
int16_t ta_envelope_value(const ta_envelope *e, const ta_phasor *turns, uint8_t carriers);

/*@ requires \valid_read(p) && in_range(p);
    assigns \nothing; */
static bool envelopes_ready(const ta_player *p);

/*@ requires \valid_read(p) && in_range(p);
    assigns \nothing; */
static ta_set missing(const ta_player *p);

/*@ requires \valid_read(p) && in_range(p);
    assigns \nothing; */
static bool all_ready(const ta_player *p);

/*@ requires \valid(p) && in_range(p);
    assigns p->bridging, p->bridges[0 .. TA_CHANNELS - 1]; */
static bool begin_bridges(ta_player *p, ta_set channels);

/*@ requires \valid(p) && in_range(p);
    assigns p->bridging, p->bridges[0 .. TA_CHANNELS - 1]; */
static bool all_go_on(ta_player *p);

/*@ requires \valid(p) && in_range(p);
    assigns p->kept.envelopes[0 .. TA_CHANNELS - 1]; */
static void stop_envelopes(ta_player *p);

/*@ requires \valid(p);
    assigns p->phase, p->bridging; */
static void stop_values(ta_player *p);

/*@ requires apart(p);
    assigns p->phase, p->bridging, p->starving, p->counters->underruns; */
static void starve(ta_player *p);

/*@ requires apart(p) && in_range(p);
    assigns p->phase, p->gain, p->starving, p->bridging, p->bridges[0 .. TA_CHANNELS - 1],
            p->kept.envelopes[0 .. TA_CHANNELS - 1], p->counters->underruns;
    ensures p->gain <= p->gain_full; */
static void settle(ta_player *p, bool come);

/*@ requires \valid(p) && channel < TA_CHANNELS;
    assigns p->values[channel], p->bridges[channel], p->bridging; */
static void next_of_bridge(ta_player *p, size_t channel);

/*@ requires \valid(p) && in_range(p);
    assigns p->values[0 .. TA_CHANNELS - 1]; */
static void take_samples(ta_player *p);

/*@ requires \valid(p) && in_range(p);
    assigns p->values[0 .. TA_CHANNELS - 1], p->bridges[0 .. TA_CHANNELS - 1], p->bridging; */
static void next_samples(ta_player *p);

/*@ requires \valid(p) && \valid(e) && \valid_read(turns + (0 .. p->carriers - 1));
    assigns *e; */
static int16_t spectrum_value(ta_player *p, ta_envelope *e, const ta_phasor *turns);

/*@ requires \valid(p) && in_range(p);
    assigns p->values[0 .. TA_CHANNELS - 1], p->kept.envelopes[0 .. TA_CHANNELS - 1]; */
static void next_spectrum(ta_player *p);

/*@ requires \valid(p) && in_range(p);
    assigns p->kept.envelopes[0 .. TA_CHANNELS - 1]; */
static void end_envelopes(ta_player *p);

/*@ requires apart(p) && in_range(p);
    assigns p->phase, p->gain, p->starving, p->bridging, p->bridges[0 .. TA_CHANNELS - 1],
            p->values[0 .. TA_CHANNELS - 1], p->kept.envelopes[0 .. TA_CHANNELS - 1],
            p->counters->lost_samples, p->counters->underruns;
    ensures p->gain <= p->gain_full; */
static void play(ta_player *p, uint8_t state, bool come);

/*@ requires \valid(p) && set_up(p) && p->gain <= p->gain_full;
    assigns p->gain;
    ensures p->gain <= p->gain_full; */
static void move_gain(ta_player *p, uint8_t state);

/* A START may follow limits with a smaller N, which g of the last stream is above. */
/*@ requires \valid(p);
    assigns p->position, p->fill, p->moved, p->phase, p->gain, p->quick, p->held_down;
    ensures p->gain == 0 && p->fill == 0; */
void ta_player_start(ta_player *p, uint32_t position);

/*@ predicate plays(integer state) = state == TP_STATE_RUNNING || state == TP_STATE_RAMPDOWN; */

/* Section 11.2: after an instant every code is bounded, whatever the state. */
/*@ requires \valid(p) && set_up(p) && codes_fit(p) && held_fits(p) && (plays(state) ==> in_range(p));
    requires apart(p);
    ensures stepped{Pre, Post}(p, p->channels) && codes_fit(p) && held_fits(p) && set_up(p);
    ensures p->limit == \old(p->limit) && p->step == \old(p->step) && p->channels == \old(p->channels);
    ensures plays(state) ==> in_range(p);
    ensures p->silent <==> still(p, p->channels); */
void ta_player_instant(ta_player *p, uint8_t state, bool come);

#include "../tactile_player.c"
