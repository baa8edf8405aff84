/* The amplifier of SPEC.md: states, session, watchdog, sample clock, checks and answers.
 *
 * Firmware has one `ta_amplifier`, a link (tactile_link.h) and a timer; all is integer arithmetic in fixed
 * memory. It is of two contexts, or of one:
 *
 * - The interrupt of the timer calls ta_run, a loop feeds the link and calls ta_serve. An interrupt of the e-stop
 *   input or of a fault has the priority of the timer's, so that neither interrupts the other. The loop's calls
 *   may be interrupted anywhere, but where the core has called `mask` of the HAL.
 * - Without `mask`, a loop calls all of it, and nothing overlaps. Reports are sent where they arise.
 */
#ifndef TACTILE_AMPLIFIER_H
#define TACTILE_AMPLIFIER_H

#include "tactile_guard.h"
#include "tactile_hal.h"
#include "tactile_marks.h"
#include "tactile_packet.h"
#include "tactile_player.h"
#include "tactile_reports.h"

/* Properties of the board; CAPS tells most of them to the host. */
typedef struct {
    uint8_t node;     /* 1 ... 127 */
    uint8_t channels; /* at most TA_CHANNELS */
    uint8_t carriers; /* at most TA_CARRIERS; 0: no spectrum frames, and bit 3 of formats is 0 */
    bool holds;       /* holds each sample instead of interpolating */
    uint16_t formats; /* bit f is set for sample format f */
    uint16_t packet_limit;
    uint16_t fifo_samples; /* at most TA_FIFO, and 64 ms at rate_max_hz at least */
    uint16_t sense_range_ua; /* of the current at power-up, not 0 where the HAL has `currents` */
    uint8_t current_delay;   /* instants by which its codes are late, at most TA_CURRENT_DELAY */
    uint8_t marker_lines;    /* at most TA_MARKER_LINES; 0: none */
    uint32_t lateness; /* ticks by which an instant may be late; 0: any. Later ones are skipped (7.1) */
    uint32_t tick_hz;     /* 10 x rate_max_hz at least */
    uint32_t rate_min_hz; /* at least 1 kHz */
    uint32_t rate_max_hz; /* at most 1 MHz */
    uint32_t full_scale_uv;
    uint32_t voltage_limit_uv;
    uint32_t slew_limit_v_per_s;
    uint32_t fade_limit_us;
    uint32_t firmware;
    char name[16];
} ta_config;

typedef struct {
    ta_config config;
    ta_hal hal;
    ta_counters counters;
    ta_player player;
    ta_marks marks;

    /* State, section 6. */
    uint8_t state;
    uint8_t then; /* state that follows RAMPDOWN */
    bool high_voltage;
    bool announce; /* the state has changed and PULSE is to be sent */
    uint8_t estop_reason;
    uint8_t fault;          /* latest fault of the hardware, as STATUS tells it */
    uint8_t hardware_fault; /* fault that persists now, 0 for none */
    uint16_t session;

    /* E-stop input, section 6.3. */
    bool contact_open; /* latest reading of the contact */
    bool contact_was_open; /* the contact has been open since power-up */
    uint64_t contact_closed; /* tick of the last closing */

    /* Limits in force, section 11.1. */
    uint32_t voltage_uv;
    uint32_t slew_v_per_s;
    uint32_t fade_us;

    /* Watchdog, section 6.2. */
    bool watched;
    uint64_t heartbeat; /* tick of the last HEARTBEAT or ARM */
    bool alive;         /* this session has sent HEARTBEAT or ARM (6.1) */

    /* Sample clock, section 7.1: the next instant and the remainder of k x tick_hz / rate. */
    uint64_t next;
    uint32_t remainder;
    uint32_t period; /* quotient and remainder of tick_hz / rate */
    uint32_t period_rest;
    bool start_pending;
    uint64_t start_tick;
    uint32_t start_position;
    uint64_t last_tick;     /* tick and position of the latest instant */
    uint32_t last_position;

    /* Messages that the amplifier sends unasked. */
    ta_reports reports;
    bool pulse_now;
    uint64_t pulse_tick;
    bool sense_now;
    uint64_t sense_tick;
    uint8_t seq;
    uint32_t refusal_detail; /* of the NAK to the request that is handled */

    /* Parameters, and index and tick of the last SYNC. */
    uint8_t node;
    uint8_t next_node; /* address from the packet after the answer on */
    uint32_t pulse_ms;
    uint32_t sense_ms;
    uint32_t correlation_ms;
    uint16_t sense_range_ua;
    uint32_t log_level;
    uint8_t sync_index;
    uint64_t sync_tick;

#if TA_CORRELATES
    ta_correlator correlator;
    ta_guard guard;
#endif
} ta_amplifier;

/* A field with a value that SPEC.md does not allow, and what it allows; of a field that is no number,
 * such as a function or the name, all three are 0. */
typedef struct {
    const char *field; /* of ta_config or ta_hal */
    uint32_t value;
    uint32_t least;
    uint32_t most;
} ta_bounds;

/* Returns the name of the first field that SPEC.md does not allow, or that the arrays have no room for;
 * NULL for none. `bounds` may be NULL. Of `formats` one of the bits 0 ... 3 is set; for `estop_open` the
 * bounds are those of full_scale_uv without an e-stop input (6.3). */
const char *ta_config_fault(const ta_config *config, const ta_hal *hal, ta_bounds *bounds);

/* Powers up at tick 0. Returns false, and does nothing, where ta_config_fault names a field. */
bool ta_init(ta_amplifier *amp, const ta_config *config, const ta_hal *hal);

/* Carries out all sample instants up to and including `now`, or skips those that are later than the configuration
 * allows. */
void ta_run(ta_amplifier *amp, uint64_t now);

/* Sends what the instants have noted: PULSE, LOG, SENSE, CORRELATION, GUARDED and MARKED. The loop of firmware of two
 * contexts calls it once per ms or so; with one context it has nothing to do. */
void ta_serve(ta_amplifier *amp);

/* Handles a packet whose last byte arrived at `now`, which instants may have passed meanwhile. */
void ta_receive(ta_amplifier *amp, const uint8_t *packet, size_t size, uint64_t now);

/* Handles a message without header and CRC-32, from a prompt frame of CAN (section 3.2). */
void ta_receive_prompt(ta_amplifier *amp, uint8_t type, const uint8_t *payload, size_t size,
                       uint64_t now);

/* Reports a fault of the hardware, or with code 0 that it is over; from the interrupt of its pin, or from one
 * of the timer's priority. */
void ta_fault(ta_amplifier *amp, uint8_t code, uint64_t now);

/* Reads the e-stop input now; meant for an interrupt of its pin where a sample period is long. Without
 * this call ta_run reads the input at each instant. */
void ta_estop_input(ta_amplifier *amp, uint64_t now);

/* Returns the tick of the next sample instant, to set a timer by. It belongs to the interrupt: the loop masks that
 * around it. ARM and START move the next instant. */
uint64_t ta_next_instant(const ta_amplifier *amp);

#endif
