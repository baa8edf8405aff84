/* Contracts of the last stage (SPEC.md 11.2), which WP proves for every player: any gains, values and codes of
 * before, any limit up to full scale and any step. */
#include "../tactile_player.h"

#define FULL 32767

/*@ requires limit >= 0;
    assigns \nothing;
    ensures \result == (value > limit ? limit : value < -limit ? -limit : value); */
static int32_t ta_clamp(int32_t value, int32_t limit);

/* A code goes by a step at most, and it is within the limit or nearer to it by a step. */
/*@ predicate bounded(integer code, integer before, integer limit, integer step) =
      -step <= code - before <= step &&
      (-limit <= code <= limit || limit < code <= before - step || before + step <= code < -limit); */

/*@ requires \valid(code) && 0 <= step && -FULL <= *code <= FULL && -FULL <= want <= FULL;
    assigns *code;
    ensures \result == *code && -FULL <= *code <= FULL;
    ensures \forall integer limit; -limit <= want <= limit ==> bounded(*code, \old(*code), limit, step); */
static int16_t step_to(int16_t *code, int32_t want, int32_t step);

#include "../tactile_player.c"
