/* Actions of the amplifier without a request: states, sample clock, watchdog, messages sent unasked. */
#include "tactile_internal.h"

#define POWER_UP_RATE 8000u
#define POWER_UP_PULSE_MS 10u

static const uint8_t on_watchdog[] = TP_TABLE_WATCHDOG;
static const uint8_t on_fault[] = TP_TABLE_FAULT;
static const uint8_t on_estop_input[] = TP_TABLE_ESTOP_INPUT;

/* Power-up */

static uint32_t power_up_rate(const ta_config *c)
{
    if (c->rate_min_hz > POWER_UP_RATE) {
        return c->rate_min_hz;
    }
    return c->rate_max_hz < POWER_UP_RATE ? c->rate_max_hz : POWER_UP_RATE;
}

static void read_input(ta_amplifier *amp, uint64_t now);

bool ta_init(ta_amplifier *amp, const ta_config *config, const ta_hal *hal)
{
    if (ta_config_fault(config, hal, NULL) != NULL) {
        return false;
    }
    memset(amp, 0, sizeof *amp);
    amp->config = *config;
    amp->hal = *hal;
    amp->node = config->node;
    amp->next_node = config->node;
    amp->pulse_ms = POWER_UP_PULSE_MS;
    amp->log_level = TP_LOG_LEVEL_WARNING;
    amp->sense_range_ua = config->sense_range_ua;
    ta_correlation_start(amp);
    ta_player_init(&amp->player, &amp->counters, config->channels, config->fifo_samples);
    ta_set_rate(amp, power_up_rate(config), 0);
    ta_limit(amp, config->voltage_limit_uv, config->slew_limit_v_per_s, config->fade_limit_us);
    read_input(amp, 0);
    return true;
}

/* Limits, section 11.1 */

int32_t ta_limit_codes(const ta_config *c, uint32_t voltage_uv)
{
    uint64_t limit = (uint64_t)voltage_uv * TP_FULL_SCALE_CODE / c->full_scale_uv;
    return (int32_t)(limit < TP_FULL_SCALE_CODE ? limit : TP_FULL_SCALE_CODE);
}

static int32_t step_codes(const ta_config *c, uint32_t slew_v_per_s, uint32_t rate)
{
    uint64_t codes = (uint64_t)slew_v_per_s * TP_FULL_SCALE_CODE * 1000000u;
    uint64_t step = codes / ((uint64_t)c->full_scale_uv * rate);
    return step < 2u * TP_FULL_SCALE_CODE ? (int32_t)step : 2 * (int32_t)TP_FULL_SCALE_CODE;
}

bool ta_reach_zero(const ta_config *c, uint32_t voltage_uv, uint32_t slew_v_per_s, uint32_t rate)
{
    int64_t reach = (int64_t)step_codes(c, slew_v_per_s, rate) * (int64_t)(rate / 50u);
    return ta_limit_codes(c, voltage_uv) <= reach;
}

/* Derives the player's numbers from limits and rate. */
static void derive(ta_amplifier *amp)
{
    ta_player *p = &amp->player;
    uint64_t gain = ((uint64_t)amp->fade_us * p->rate + 500000u) / 1000000u;
    p->limit = ta_limit_codes(&amp->config, amp->voltage_uv);
    p->step = step_codes(&amp->config, amp->slew_v_per_s, p->rate);
    p->gain_full = gain > 0 ? (uint32_t)gain : 1u;
}

void ta_limit(ta_amplifier *amp, uint32_t voltage_uv, uint32_t slew_v_per_s, uint32_t fade_us)
{
    amp->voltage_uv = voltage_uv;
    amp->slew_v_per_s = slew_v_per_s;
    amp->fade_us = fade_us;
    derive(amp);
}

uint8_t ta_phase(const ta_amplifier *amp)
{
    return amp->state == TP_STATE_RUNNING ? amp->player.phase : (uint8_t)TP_PHASE_STILL;
}

/* Correlation, section 16 */

#if TA_CORRELATES

bool ta_correlates(const ta_amplifier *amp)
{
    return amp->hal.currents != NULL;
}

void ta_correlation_start(ta_amplifier *amp)
{
    ta_correlator_start(&amp->correlator, amp->config.channels, amp->config.current_delay);
    ta_guard_start(&amp->guard, amp->config.channels, amp->player.rate);
}

void ta_correlation_stop(ta_amplifier *amp)
{
    ta_correlator_stop(&amp->correlator);
}

static uint16_t window_samples(const ta_amplifier *amp)
{
    uint64_t samples = (uint64_t)amp->correlation_ms * amp->player.rate / 1000u;
    return (uint16_t)(samples < UINT16_MAX ? samples : UINT16_MAX);
}

/* Adds the currents that are known now to the window under way, or to one that begins. */
static void add_to_window(ta_amplifier *amp, uint32_t position, const int16_t *currents)
{
    ta_correlator *c = &amp->correlator;
    if (c->left == 0 && amp->correlation_ms == 0) {
        return;
    }
    ta_correlator_open(c, position, window_samples(amp), amp->sense_range_ua);
    for (size_t i = 0; i < amp->config.channels; i++) {
        if (amp->player.held[i] < TA_GAIN_FULL) {
            ta_correlator_held(c, i);
        }
    }
    switch (ta_correlator_add(c, currents)) {
    case TA_WINDOW_COMPLETE:
        ta_note_correlation(amp);
        break;
    case TA_WINDOW_LOST:
        amp->counters.dropped_replies++;
        break;
    default:
        break;
    }
}

/* After the sample at `position` was put out; `come` says that the tick of START has come. */
static void correlate(ta_amplifier *amp, uint32_t position, bool come)
{
    int16_t currents[TA_CHANNELS];
    if (!ta_correlates(amp)) {
        return;
    }
    if (amp->state != TP_STATE_RUNNING || !come) {
        ta_correlator_stop(&amp->correlator);
        return;
    }
    if (!ta_correlator_played(&amp->correlator, amp->player.codes)) {
        return;
    }
    amp->hal.currents(amp->hal.context, currents);
    add_to_window(amp, position, currents);
    if (ta_guard_add(&amp->guard, &amp->correlator, currents)) {
        ta_note_guarded(amp, position + 1u);
    }
}

/* An instant that is skipped ends the window, since nobody has measured its currents. */
static void skip_correlation(ta_amplifier *amp)
{
    if (ta_correlates(amp)) {
        ta_correlator_stop(&amp->correlator);
        (void)ta_correlator_played(&amp->correlator, amp->player.codes);
        ta_guard_skip(&amp->guard);
    }
}

/* The gains of the guards at this instant. */
static void move_guards(ta_amplifier *amp)
{
    if (amp->state == TP_STATE_RUNNING && !amp->start_pending) {
        amp->player.held_down = ta_guard_move(&amp->guard, amp->player.held);
    }
}

#else

bool ta_correlates(const ta_amplifier *amp)
{
    (void)amp;
    return false;
}

void ta_correlation_start(ta_amplifier *amp)
{
    (void)amp;
}

void ta_correlation_stop(ta_amplifier *amp)
{
    (void)amp;
}

static void correlate(ta_amplifier *amp, uint32_t position, bool come)
{
    (void)amp;
    (void)position;
    (void)come;
}

static void skip_correlation(ta_amplifier *amp)
{
    (void)amp;
}

static void move_guards(ta_amplifier *amp)
{
    (void)amp;
}

#endif

/* Markers, section 18 */

#if TA_MARKER_LINES > 0

/* Settles the marker lines of this instant. Returns whether a mark is shown from it on. */
static bool show_marks(ta_amplifier *amp)
{
    ta_marks *m = &amp->marks;
    if (ta_marks_rest(m)) {
        return false;
    }
    bool plays = ta_phase(amp) == TP_PHASE_PLAYING;
    uint8_t before = m->lines;
    bool shown = ta_marks_instant(m, amp->player.position, amp->start_pending, plays);
    if (m->lines != before) {
        amp->hal.marks(amp->hal.context, m->lines);
    }
    return shown;
}

static void report_mark(ta_amplifier *amp, bool shown)
{
    if (shown) {
        ta_note_marked(amp, amp->player.position);
    }
}

static void skip_marks(ta_amplifier *amp)
{
    if (!ta_marks_rest(&amp->marks)) {
        ta_marks_skip(&amp->marks, amp->player.position, amp->start_pending);
    }
}

#else

static bool show_marks(ta_amplifier *amp)
{
    (void)amp;
    return false;
}

static void report_mark(ta_amplifier *amp, bool shown)
{
    (void)amp;
    (void)shown;
}

static void skip_marks(ta_amplifier *amp)
{
    (void)amp;
}

#endif

/* Firmware of one context sends a report where it was noted. */
static void serve_at_once(ta_amplifier *amp)
{
    if (amp->hal.mask == NULL) {
        ta_serve(amp);
    }
}

/* States, section 6 */

static void switch_high_voltage(ta_amplifier *amp, bool on)
{
    if (amp->high_voltage != on) {
        amp->high_voltage = on;
        amp->hal.high_voltage(amp->hal.context, on);
    }
}

/* The high voltage that a state asks for, which goes off at 0 V only. */
static void settle_high_voltage(ta_amplifier *amp)
{
    bool on = amp->state == TP_STATE_ARMED || amp->state == TP_STATE_RUNNING ||
              amp->state == TP_STATE_RAMPDOWN;
    if (on || amp->player.silent) {
        switch_high_voltage(amp, on);
    }
}

static void enter(ta_amplifier *amp, uint8_t state)
{
    if (amp->state != state) {
        amp->state = state;
        amp->announce = true;
        amp->start_pending = amp->start_pending && state == TP_STATE_RUNNING; /* 7.1 */
        settle_high_voltage(amp);
    }
}

void ta_apply(ta_amplifier *amp, uint8_t entry)
{
    uint8_t state = entry & 7u;
    if ((entry & (TP_TABLE_STAYS | TP_TABLE_REFUSED)) != 0) {
        return;
    }
    if (state == TP_STATE_RAMPDOWN) {
        amp->then = (uint8_t)(entry >> 3 & 7u);
    }
    enter(amp, state);
}

void ta_fault(ta_amplifier *amp, uint8_t code, uint64_t now)
{
    ta_run(amp, now);
    amp->hardware_fault = code;
    if (code == TP_FAULT_NONE) {
        return;
    }
    amp->fault = code;
    amp->counters.trips++;
    ta_apply(amp, on_fault[amp->state]);
    if (amp->announce) {
        ta_announce(amp);
        ta_note_log(amp, TP_LOG_LEVEL_ERROR, NULL, code);
    }
    serve_at_once(amp);
}

/* E-stop input, section 6.3: an opening acts at once, a closing when it has lasted. */
static void read_input(ta_amplifier *amp, uint64_t now)
{
    bool open = amp->hal.estop_open != NULL && amp->hal.estop_open(amp->hal.context);
    if (open == amp->contact_open) {
        return;
    }
    amp->contact_open = open;
    if (!open) {
        amp->contact_closed = now;
        return;
    }
    amp->contact_was_open = true;
    amp->estop_reason = TP_ESTOP_REASON_INPUT;
    amp->counters.trips++;
    ta_apply(amp, on_estop_input[amp->state]);
    if (amp->announce) {
        ta_announce(amp);
        ta_note_log(amp, TP_LOG_LEVEL_ERROR, "e-stop input open", 0);
    }
}

void ta_estop_input(ta_amplifier *amp, uint64_t now)
{
    ta_run(amp, now);
    read_input(amp, now);
    serve_at_once(amp);
}

bool ta_input_open(const ta_amplifier *amp, uint64_t now)
{
    bool settling = amp->contact_was_open && !ta_elapsed(now, amp->contact_closed, TP_INPUT_CLOSED_MS,
                                                         amp->config.tick_hz);
    return amp->contact_open || settling;
}

/* Section 6.2. It fires once: a HEARTBEAT or ARM sets it going again. */
static void watch(ta_amplifier *amp, uint64_t tick)
{
    bool runs = (on_watchdog[amp->state] & TP_TABLE_STAYS) == 0;
    if (!runs || !amp->watched ||
        !ta_elapsed(tick, amp->heartbeat, TP_WATCHDOG_MS, amp->config.tick_hz)) {
        return;
    }
    uint8_t then = amp->then;
    amp->watched = false;
    ta_apply(amp, on_watchdog[amp->state]);
    if (!amp->announce && amp->then == then) {
        return;
    }
    amp->counters.watchdogs++;
    ta_announce(amp);
    ta_note_log(amp, TP_LOG_LEVEL_WARNING, "watchdog: no heartbeat", 0);
}

/* Sample clock, section 7.1 */

/* One period on: base + floor(k x tick_hz / rate), by carrying the remainder. */
static void next_period(ta_amplifier *amp)
{
    amp->next += amp->period;
    amp->remainder += amp->period_rest;
    if (amp->remainder >= amp->player.rate) {
        amp->remainder -= amp->player.rate;
        amp->next++;
    }
}

/* No instant follows another at once: a request is of a tick that may be before the latest instant. */
static void set_base(ta_amplifier *amp, uint64_t base)
{
    amp->next = base > amp->last_tick ? base : amp->last_tick;
    amp->remainder = 0;
    next_period(amp);
}

void ta_set_rate(ta_amplifier *amp, uint32_t rate, uint64_t now)
{
    if (amp->player.rate != rate) {
        amp->player.rate = rate;
        amp->period = amp->config.tick_hz / rate;
        amp->period_rest = amp->config.tick_hz % rate;
        set_base(amp, now);
    }
    derive(amp);
}

/* Whether the next instant is that of a START. */
static bool start_is_next(const ta_amplifier *amp)
{
    return amp->start_pending && amp->next >= amp->start_tick;
}

uint64_t ta_next_instant(const ta_amplifier *amp)
{
    return start_is_next(amp) ? amp->start_tick : amp->next;
}

/* Takes the next instant, and returns its tick. */
static uint64_t take_instant(ta_amplifier *amp)
{
    uint64_t tick = ta_next_instant(amp);
    if (start_is_next(amp)) {
        amp->start_pending = false;
        set_base(amp, amp->start_tick);
    } else {
        next_period(amp);
    }
    amp->last_tick = tick;
    return tick;
}

/* Actions at an instant */

static void pulse_if_due(ta_amplifier *amp, uint64_t tick)
{
    if (amp->session == 0) {
        return;
    }
    if (amp->pulse_now || ta_elapsed(tick, amp->pulse_tick, amp->pulse_ms, amp->config.tick_hz)) {
        amp->pulse_now = false;
        amp->pulse_tick = tick;
        ta_note_pulse(amp);
    }
}

static void sense_if_due(ta_amplifier *amp, uint64_t tick)
{
    if (amp->sense_ms == 0) {
        return;
    }
    if (amp->sense_now || ta_elapsed(tick, amp->sense_tick, amp->sense_ms, amp->config.tick_hz)) {
        amp->sense_now = false;
        amp->sense_tick = tick;
        ta_note_sense(amp);
        serve_at_once(amp); /* measured before the codes change */
    }
}

/* The sample with its mark, and the position after it. */
static void put_out(ta_amplifier *amp, uint64_t tick)
{
    ta_player *p = &amp->player;
    move_guards(amp);
    ta_player_instant(p, amp->state, !amp->start_pending);
    amp->last_position = p->position;
    bool marked = show_marks(amp);
    amp->hal.put_out(amp->hal.context, tick, p->position, p->codes);
    correlate(amp, p->position, !amp->start_pending);
    report_mark(amp, marked);
    ta_player_move(p, amp->start_pending);
}

/* Section 11.2: RAMPDOWN ends after the instant at which g and all outputs are 0. */
static void end_rampdown(ta_amplifier *amp)
{
    if (amp->state == TP_STATE_RAMPDOWN && amp->player.gain == 0 &&
        amp->player.silent) {
        enter(amp, amp->then);
    }
}

static void instant(ta_amplifier *amp)
{
    uint64_t tick = take_instant(amp);
    read_input(amp, tick);
    watch(amp, tick);
    pulse_if_due(amp, tick);
    sense_if_due(amp, tick);
    put_out(amp, tick);
    end_rampdown(amp);
    settle_high_voltage(amp);
    ta_announce(amp);
    serve_at_once(amp);
    if (amp->hal.after != NULL) {
        amp->hal.after(amp->hal.context, tick, amp->state, amp->high_voltage);
    }
}

/* The codes of this instant can no longer be put out in time. */
static void skip(ta_amplifier *amp)
{
    (void)take_instant(amp);
    amp->last_position = amp->player.position;
    skip_correlation(amp);
    skip_marks(amp);
    ta_player_skip(&amp->player, amp->state, amp->start_pending);
}

void ta_run(ta_amplifier *amp, uint64_t now)
{
    const uint32_t lateness = amp->config.lateness;
    while (ta_next_instant(amp) <= now) {
        if (lateness != 0 && now - ta_next_instant(amp) > lateness) {
            skip(amp);
        } else {
            instant(amp);
        }
    }
}

void ta_catch_up(ta_amplifier *amp, uint64_t now)
{
    if (amp->hal.mask == NULL) {
        ta_run(amp, now);
    }
}
