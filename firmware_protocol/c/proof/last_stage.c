/* Contracts of the last stage (SPEC.md 11.2), which WP proves for every player: any gains, values and codes of
 * before, any limit up to full scale and any step. */
#include "player.h"

/*@ lemma narrow: \forall int16_t code; (uint16_t)code == 0 <==> code == 0; */

/*@ requires limit >= 0;
    assigns \nothing;
    ensures \result == (value > limit ? limit : value < -limit ? -limit : value); */
static int32_t ta_clamp(int32_t value, int32_t limit);

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

#include "../tactile_player.c"
