/* Contracts of what the last stage takes for granted of limits and gains, which WP proves for every configuration
 * that ta_config_fault allows. */
#include "player.h"

#include "../tactile_internal.h"

#define RATE_MOST 1000000

/*@ requires \valid_read(c) && c->full_scale_uv >= 1;
    assigns \nothing;
    ensures 0 <= \result <= FULL; */
int32_t ta_limit_codes(const ta_config *c, uint32_t voltage_uv);

/*@ requires \valid_read(c) && c->full_scale_uv >= 1 && 1 <= rate <= RATE_MOST;
    assigns \nothing;
    ensures 0 <= \result <= 2 * FULL; */
static int32_t step_codes(const ta_config *c, uint32_t slew_v_per_s, uint32_t rate);

/*@ requires \valid(amp) && amp->config.full_scale_uv >= 1 && 1 <= amp->player.rate <= RATE_MOST;
    requires amp->fade_us <= 1000 * TP_FADE_MS && 1 <= amp->player.channels <= TA_CHANNELS;
    assigns amp->player.limit, amp->player.step, amp->player.gain_full;
    ensures set_up(&amp->player); */
static void derive(ta_amplifier *amp);

#include "../tactile_amplifier.c"
