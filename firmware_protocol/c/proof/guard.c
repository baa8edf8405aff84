/* Contracts of the gains of guards (SPEC.md 17.4), which WP proves for any currents and entries. */
#include "../tactile_guard.h"

#define RATE_MOST 1000000 /* by ta_config_fault */

/*@ predicate paced(ta_guard *g) = 1 <= g->fall <= TA_GAIN_FULL && 1 <= g->rise <= TA_GAIN_FULL; */

/*@ requires rate <= RATE_MOST && 1 <= hertz;
    assigns \nothing;
    ensures 1 <= \result <= TA_GAIN_FULL; */
static int32_t per_instant(uint32_t rate, uint32_t hertz);

/*@ requires \valid_read(g) && paced(g) && channel < TA_CHANNELS && 0 <= gain <= TA_GAIN_FULL;
    assigns \nothing;
    ensures 0 <= \result <= TA_GAIN_FULL; */
static int32_t moved(const ta_guard *g, size_t channel, int32_t gain);

/*@ requires \valid(g) && paced(g) && g->channels <= TA_CHANNELS;
    requires \valid(gains + (0 .. g->channels - 1)) && \separated(g, gains + (0 .. g->channels - 1));
    requires \forall integer c; 0 <= c < g->channels ==> 0 <= gains[c] <= TA_GAIN_FULL;
    assigns g->moves, gains[0 .. g->channels - 1];
    ensures \forall integer c; 0 <= c < g->channels ==> 0 <= gains[c] <= TA_GAIN_FULL; */
bool ta_guard_move(ta_guard *g, int32_t *gains);

#include "../tactile_guard.c"
