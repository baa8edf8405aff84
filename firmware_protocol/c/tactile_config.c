/* What SPEC.md asks of a board: the ranges of CAPS (section 4), the e-stop input (6.3), the spectrum
 * profile (10), the way to 0 V (11.1), the range of the current (16) and the marker lines (18). */
#include "tactile_internal.h"

#define RATE_LEAST 1000u
#define RATE_MOST 1000000u /* up to here all products fit their types */
#define BUFFER_MS 64u
#define TICKS_PER_SAMPLE 10u
#define SLEW_MOST 100000000u
#define FORMATS 0x0Fu
#define NAME_SIZE (sizeof ((ta_config *)0)->name)

/* The table in the order of section 4, after what the board alone knows; each row may rely on those
 * before it. */
static const char *out_of_range(const ta_config *c, ta_bounds *fault)
{
    const ta_bounds rows[] = {
        {"node", c->node, 1, 127},
        {"channels", c->channels, 1, TA_CHANNELS},
        {"carriers", c->carriers, 0, TA_CARRIERS},
        {"packet_limit", c->packet_limit, TA_PACKET_LEAST, TA_PACKET_MAX},
        {"rate_max_hz", c->rate_max_hz, RATE_LEAST, RATE_MOST},
        {"rate_min_hz", c->rate_min_hz, RATE_LEAST, c->rate_max_hz},
        {"fifo_samples", c->fifo_samples, (BUFFER_MS * c->rate_max_hz + 999u) / 1000u, TA_FIFO},
        {"tick_hz", c->tick_hz, TICKS_PER_SAMPLE * c->rate_max_hz, UINT32_MAX},
        {"full_scale_uv", c->full_scale_uv, 1, UINT32_MAX},
        {"voltage_limit_uv", c->voltage_limit_uv, 1, c->full_scale_uv},
        {"fade_limit_us", c->fade_limit_us, 0, 1000u * TP_FADE_MS},
    };
    for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
        if (rows[i].value < rows[i].least || rows[i].value > rows[i].most) {
            *fault = rows[i];
            return rows[i].field;
        }
    }
    return NULL;
}

/* The largest product of rate and of the step that it needs to reach 0 V in 20 ms. Of the rates with the
 * same floor(rate / 50) the highest needs the most, so that it stands for all of them (11.1). */
static uint64_t most_codes_per_s(const ta_config *c)
{
    uint32_t limit = (uint32_t)ta_limit_codes(c, c->voltage_limit_uv);
    uint64_t most = 0;
    for (uint32_t instants = c->rate_min_hz / 50u; instants <= c->rate_max_hz / 50u; instants++) {
        uint32_t highest = 50u * instants + 49u;
        uint32_t rate = highest < c->rate_max_hz ? highest : c->rate_max_hz;
        uint64_t needed = (uint64_t)((limit + instants - 1u) / instants) * rate;
        most = needed > most ? needed : most;
    }
    return most;
}

/* The least slew limit that reaches 0 V in 20 ms at every rate; UINT32_MAX stands for all above. */
static uint32_t least_slew(const ta_config *c)
{
    uint64_t per_s = most_codes_per_s(c);
    uint64_t codes = TP_FULL_SCALE_CODE * UINT64_C(1000000);
    if (per_s > UINT64_MAX / c->full_scale_uv) {
        return UINT32_MAX;
    }
    uint64_t product = per_s * c->full_scale_uv;
    uint64_t least = product / codes + (product % codes != 0 ? 1u : 0u);
    return least == 0 ? 1u : least < UINT32_MAX ? (uint32_t)least : UINT32_MAX;
}

/* Returns the number of bytes of the character in UTF-8 at the beginning of `bytes`, 0 where there is none. */
static size_t character(const uint8_t *bytes)
{
    static const uint32_t least[] = {0, 0x80, 0x800, 0x10000}; /* that a character needs so many bytes for */
    uint32_t value = bytes[0];
    size_t more = value < 0x80u ? 0 : value < 0xE0u ? 1 : value < 0xF0u ? 2 : 3;
    if (more > 0) {
        if (value < 0xC0u || value >= 0xF8u) {
            return 0;
        }
        value &= 0x3Fu >> more;
    }
    for (size_t k = 1; k <= more; k++) {
        if ((bytes[k] & 0xC0u) != 0x80u) {
            return 0;
        }
        value = value << 6 | (bytes[k] & 0x3Fu);
    }
    bool surrogate = value >> 11 == 0xD800u >> 11; /* half of a pair of UTF-16 */
    return value >= least[more] && value <= 0x10FFFFu && !surrogate ? more + 1u : 0;
}

/* Whether the name is UTF-8 and after its end all zeros (section 1). */
static bool name_allowed(const char *name)
{
    uint8_t bytes[NAME_SIZE + 3] = {0}; /* a character that is cut off finds no more of its bytes */
    size_t at = 0;
    memcpy(bytes, name, NAME_SIZE);
    while (at < NAME_SIZE && bytes[at] != 0) {
        size_t size = character(bytes + at);
        if (size == 0) {
            return false;
        }
        at += size;
    }
    while (at < NAME_SIZE) {
        if (bytes[at++] != 0) {
            return false;
        }
    }
    return true;
}

/* What is no number of the table, or depends on more than it. */
static const char *not_allowed(const ta_config *c, const ta_hal *hal, ta_bounds *fault)
{
    const ta_bounds rows[] = {
        {"slew_limit_v_per_s", c->slew_limit_v_per_s, least_slew(c), SLEW_MOST},
        {"formats", c->formats, 1, FORMATS},
        {"marker_lines", c->marker_lines, 0, TA_MARKER_LINES},
        {"carriers", c->carriers, 1, TA_CARRIERS},
        {"estop_open", c->full_scale_uv, 1, TP_UNGUARDED_MOST_UV},
        {"sense_range_ua", c->sense_range_ua, 1, UINT16_MAX},
        {"current_delay", c->current_delay, 0, TA_CURRENT_DELAY},
        {"name", 0, 0, 0},
    };
    bool spectrum = (c->formats >> TP_SAMPLE_FORMAT_SPECTRUM8 & 1u) != 0;
    const bool wrong[] = {
        rows[0].value < rows[0].least || rows[0].value > rows[0].most,
        (c->formats & FORMATS) == 0,
        c->marker_lines >= TA_MARKER_LINES + 1u,
        spectrum && c->carriers == 0,
        hal->estop_open == NULL && c->full_scale_uv > TP_UNGUARDED_MOST_UV,
        hal->currents != NULL && c->sense_range_ua == 0,
        c->current_delay >= TA_CURRENT_DELAY + 1u,
        !name_allowed(c->name),
    };
    for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
        if (wrong[i]) {
            *fault = rows[i];
            return rows[i].field;
        }
    }
    return NULL;
}

const char *ta_config_fault(const ta_config *c, const ta_hal *hal, ta_bounds *bounds)
{
    ta_bounds unused;
    ta_bounds *fault = bounds != NULL ? bounds : &unused;
    memset(fault, 0, sizeof *fault);
    fault->field = hal->send == NULL           ? "send"
                   : hal->put_out == NULL      ? "put_out"
                   : hal->high_voltage == NULL ? "high_voltage"
                   : (hal->mask == NULL) != (hal->unmask == NULL) ? "unmask"
                   : hal->marks == NULL && c->marker_lines != 0   ? "marks"
                                               : NULL;
    if (fault->field != NULL) {
        return fault->field;
    }
    const char *field = out_of_range(c, fault);
    return field != NULL ? field : not_allowed(c, hal, fault);
}
