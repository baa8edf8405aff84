/* Contracts of the last stage (SPEC.md 11.2), which WP proves for every player: any gains, values and codes of
 * before, any limit up to full scale and any step. */
#include "../tactile_player.h"

#define FULL 32767
#define GAIN_MOST 20000 /* TP_FADE_MS at the highest rate that ta_config_fault allows, 1 MHz */

/*@ requires limit >= 0;
    assigns \nothing;
    ensures \result == (value > limit ? limit : value < -limit ? -limit : value); */
static int32_t ta_clamp(int32_t value, int32_t limit);

/* A code goes by a step at most, and it is within the limit or nearer to it by a step. */
/*@ predicate bounded(integer code, integer before, integer limit, integer step) =
      -step <= code - before <= step &&
      (-limit <= code <= limit || limit < code <= before - step || before + step <= code < -limit); */

/* Names for the elements of arrays, so that Z3 sees which of them a statement is of. */
/*@ axiomatic elements {
      logic integer code{L}(ta_player *p, integer c) reads p->codes[c];
      logic integer gain{L}(ta_player *p, integer c) reads p->held[c];
      axiom code_is{L}: \forall ta_player *p, integer c; code(p, c) == p->codes[c];
      axiom gain_is{L}: \forall ta_player *p, integer c; gain(p, c) == p->held[c];
    } */

/*@ lemma narrow: \forall int16_t code; (uint16_t)code == 0 <==> code == 0; */

/*@ predicate fits(integer code) = -FULL <= code <= FULL; */

/*@ predicate set_up(ta_player *p) =
      1 <= p->channels <= TA_CHANNELS && 0 <= p->limit <= FULL && 0 <= p->step && 1 <= p->gain_full <= GAIN_MOST; */

/*@ predicate codes_fit(ta_player *p) = \forall integer c; 0 <= c < p->channels ==> fits(code(p, c)); */

/*@ predicate held_fits(ta_player *p) =
      \forall integer c; 0 <= c < p->channels ==> 0 <= gain(p, c) <= TA_GAIN_FULL; */

/* The first channels have gone through the last stage, and the others not yet. */
/*@ predicate stepped{L1, L2}(ta_player *p, integer channels) = \forall integer c; 0 <= c < channels ==>
      fits(code{L2}(p, c)) &&
      bounded(code{L2}(p, c), code{L1}(p, c), \at(p->limit, L1), \at(p->step, L1)); */
/*@ predicate unchanged{L1, L2}(ta_player *p, integer from) =
      \forall integer c; from <= c < \at(p->channels, L1) ==> code{L2}(p, c) == code{L1}(p, c); */

/*@ predicate others_stay{L1, L2}(ta_player *p, integer channel) = \forall integer c;
      0 <= c < \at(p->channels, L1) && c != channel ==> code{L2}(p, c) == code{L1}(p, c); */

/*@ predicate still(ta_player *p, integer channels) =
      \forall integer c; 0 <= c < channels ==> code(p, c) == 0; */

/*@ requires \valid(code) && 0 <= step && fits(*code) && fits(want);
    assigns *code;
    ensures \result == *code && fits(*code);
    ensures \forall integer limit; -limit <= want <= limit ==> bounded(*code, \old(*code), limit, step); */
static int16_t step_to(int16_t *code, int32_t want, int32_t step);

/*@ requires fits(value) && 0 <= part <= whole && 1 <= whole <= 65536;
    assigns \nothing;
    ensures 0 <= \result <= value || value <= \result <= 0; */
static int32_t portion(int32_t value, int32_t part, int32_t whole);

/*@ requires \valid(p) && set_up(p) && codes_fit(p);
    requires \valid_read(values + (0 .. p->channels - 1));
    requires \separated(values + (0 .. p->channels - 1), p->codes + (0 .. p->channels - 1));
    assigns p->codes[0 .. p->channels - 1], p->silent;
    ensures stepped{Pre, Post}(p, p->channels) && codes_fit(p);
    ensures p->silent <==> still(p, p->channels); */
static uint32_t bound(ta_player *p, const int16_t *values);

/*@ requires \valid(p) && set_up(p) && codes_fit(p) && held_fits(p) && p->gain <= p->gain_full;
    assigns p->codes[0 .. p->channels - 1], p->silent;
    ensures stepped{Pre, Post}(p, p->channels) && codes_fit(p);
    ensures p->silent <==> still(p, p->channels); */
static uint32_t bound_and_fade(ta_player *p);

/*@ requires \valid(p) && set_up(p) && codes_fit(p) && held_fits(p) && (plays ==> p->gain <= p->gain_full);
    requires \valid(p->counters) && \separated(p, p->counters);
    assigns p->codes[0 .. p->channels - 1], p->silent, p->counters->limited_samples;
    ensures stepped{Pre, Post}(p, p->channels) && codes_fit(p);
    ensures p->silent <==> still(p, p->channels); */
static void last_stage(ta_player *p, bool plays);

/* What the steps before the last stage may change: neither codes nor limits. */
/*@ requires \valid(p) && set_up(p) && p->gain <= p->gain_full;
    requires \valid(p->counters) && \separated(p, p->counters);
    assigns p->phase, p->gain, p->starving, p->bridging, p->bridges[0 .. TA_CHANNELS - 1],
            p->values[0 .. TA_CHANNELS - 1], p->kept, p->counters->lost_samples, p->counters->underruns;
    ensures p->gain <= p->gain_full; */
static void play(ta_player *p, uint8_t state, bool come);

/*@ requires \valid(p) && set_up(p) && p->gain <= p->gain_full;
    assigns p->gain;
    ensures p->gain <= p->gain_full; */
static void move_gain(ta_player *p, uint8_t state);

/*@ predicate plays(integer state) = state == TP_STATE_RUNNING || state == TP_STATE_RAMPDOWN; */

/* Section 11.2: after an instant every code is bounded, whatever the state. */
/*@ requires \valid(p) && set_up(p) && codes_fit(p) && held_fits(p) && (plays(state) ==> p->gain <= p->gain_full);
    requires \valid(p->counters) && \separated(p, p->counters);
    ensures stepped{Pre, Post}(p, p->channels) && codes_fit(p) && held_fits(p) && set_up(p);
    ensures p->limit == \old(p->limit) && p->step == \old(p->step) && p->channels == \old(p->channels);
    ensures plays(state) ==> p->gain <= p->gain_full;
    ensures p->silent <==> still(p, p->channels); */
void ta_player_instant(ta_player *p, uint8_t state, bool come);

#include "../tactile_player.c"
