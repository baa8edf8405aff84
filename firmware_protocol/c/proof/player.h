/* What the contracts of the player share. */
#ifndef PROOF_PLAYER_H
#define PROOF_PLAYER_H

#include "../tactile_player.h"

#define FULL 32767
#define GAIN_MOST 20000 /* TP_FADE_MS at the highest rate that ta_config_fault allows, 1 MHz */

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

/*@ predicate fits(integer code) = -FULL <= code <= FULL; */

/*@ predicate set_up(ta_player *p) =
      1 <= p->channels <= TA_CHANNELS && 0 <= p->limit <= FULL && 0 <= p->step && 1 <= p->gain_full <= GAIN_MOST; */

/*@ predicate apart(ta_player *p) = \valid(p) && \valid(p->counters) && \separated(p, p->counters); */

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

/* What is left of a word after k of its 32 bits. */
/*@ logic integer most(integer k) = k <= 0 ? 4294967295 : most(k - 1) / 2; */

/*@ requires \valid(p) && set_up(p) && codes_fit(p) && held_fits(p) && (plays ==> p->gain <= p->gain_full);
    requires apart(p);
    assigns p->codes[0 .. p->channels - 1], p->silent, p->counters->limited_samples;
    ensures stepped{Pre, Post}(p, p->channels) && codes_fit(p);
    ensures p->silent <==> still(p, p->channels); */
static void last_stage(ta_player *p, bool plays);

#endif
