/* What is wrong with the options of virtual-amplifier, in one line: value, limits and what would do. */
#include "virtual_amplifier.h"

typedef struct {
    const char *field;
    const char *option;
    const char *rule; /* where the limits come from */
} explanation;

static const explanation explanations[] = {
    {"node", "--node", "SPEC.md 4"},
    {"channels", "--channels", "SPEC.md 4, and the room of this program"},
    {"carriers", "--carriers", "SPEC.md 10: 1 at least with bit 3 of --formats; and the room of this program"},
    {"formats", "--formats", "SPEC.md 4: one of the bits 0 to 3 is set"},
    {"packet_limit", "--packet-limit", "SPEC.md 4"},
    {"rate_max_hz", "--rate-max", "SPEC.md 4"},
    {"rate_min_hz", "--rate-min", "SPEC.md 4: --rate-max at most"},
    {"fifo_samples", "--fifo or --rate-max", "SPEC.md 4: 64 ms at --rate-max; and the room of this program"},
    {"tick_hz", "--tick-hz", "SPEC.md 4: 10 ticks a sample at --rate-max"},
    {"full_scale_uv", "--full-scale-uv", "SPEC.md 4"},
    {"voltage_limit_uv", "--voltage-limit-uv", "SPEC.md 4: --full-scale-uv at most"},
    {"slew_limit_v_per_s", "--slew-v-per-s",
     "SPEC.md 11.1: to 0 V from --voltage-limit-uv in 20 ms at every rate"},
    {"fade_limit_us", "--fade-us", "SPEC.md 11.1"},
    {"marker_lines", "--marker-lines", "SPEC.md 4"},
    {"sense_range_ua", "--sense-ranges-ua", "SPEC.md 16"},
    {"current_delay", "--current-delay", "the room of this program"},
};

void virtual_explain(const ta_config *config, const ta_hal *hal)
{
    ta_bounds fault;
    const char *field = ta_config_fault(config, hal, &fault);
    for (size_t i = 0; field != NULL && i < sizeof explanations / sizeof explanations[0]; i++) {
        const explanation *e = &explanations[i];
        if (strcmp(field, e->field) == 0) {
            fprintf(stderr, "virtual-amplifier: %s %lu: must be %lu to %lu (%s): change %s\n", field,
                    (unsigned long)fault.value, (unsigned long)fault.least, (unsigned long)fault.most,
                    e->rule, e->option);
        }
    }
}
