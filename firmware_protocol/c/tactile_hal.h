/* Functions of the board for the amplifier: a port fills in this struct, and nothing else.
 *
 * All functions are called from where the core is called, and must not call back into it. In firmware of two
 * contexts (tactile_amplifier.h) put_out, marks, currents, estop_open and after belong to the interrupt; send,
 * clock, identify, sense, supply_mv and temperature_mk to the loop, where they may take their time; high_voltage,
 * fault and sense_range are called from either, and within a lock.
 */
#ifndef TACTILE_HAL_H
#define TACTILE_HAL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    void *context; /* first argument of all functions */

    /* Sends a packet to the host; in most firmware it is one call of ta_serial_send, ta_can_send or
     * ta_replies_push. It returns false if the link could not take the packet, which is then counted
     * as a dropped reply. */
    bool (*send)(void *context, const uint8_t *packet, size_t size);

    /* Puts out the sample codes of all channels for the instant `tick`. */
    void (*put_out)(void *context, uint64_t tick, uint32_t position, const int16_t *codes);

    /* Switches the high voltage. It is never switched off while a code is not 0. */
    void (*high_voltage)(void *context, bool on);

    /* Returns whether the contact of the e-stop input is open (6.3); in most firmware it is the level of
     * a pin with a pull-up, which the closed contact pulls down. It is called at power-up and at each
     * instant, and by ta_estop_input in between. NULL stands for no input, which is not allowed above
     * 60 V. */
    bool (*estop_open)(void *context);

    /* The rest may be NULL. */

    /* Hold off the interrupt that calls ta_run, and allow it again: both, or neither in firmware whose calls of
     * the core never overlap. They are called from the loop alone and do not nest. */
    void (*mask)(void *context);
    void (*unmask)(void *context);

    /* Is called after each instant, for a display on the board, a logger or a test. */
    void (*after)(void *context, uint64_t tick, uint8_t state, bool high_voltage);

    /* Returns the present tick, for the time of sending in TIME_REPLY; without it that is the tick of
     * reception. */
    uint64_t (*clock)(void *context);

    /* Lets a person find the board. */
    void (*identify)(void *context, uint8_t seconds);

    /* Measures a channel: voltage as a sample code, current in microamperes. CAPS has the feature if
     * this is not NULL. SENSE names the sample that is put out when the first of its channels is measured. */
    void (*sense)(void *context, uint8_t channel, int16_t *voltage, int16_t *current_ua);

    /* Gives the current codes of all channels at the instant that put_out was last called for, or
     * current_delay instants before where converters and filters delay them (16.1); it is called directly
     * after put_out, at each instant of RUNNING. A code of 32767 stands for the range of
     * the ADC, and 32767 or -32767 says that it was at an end of it. Sample the currents by the clock that
     * puts out the codes, and wait here for the conversion. CAPS has the feature if this is not NULL. */
    void (*currents)(void *context, int16_t *codes);

    /* Sets the marker lines: line k is high where bit k is set (18). It is called directly before put_out, at each
     * instant at which they change, and belongs to the codes of that instant: latch both at the same moment. Set all
     * lines with one write to a register, and keep them low from reset until the first call. It must not be NULL
     * where marker_lines of the configuration is not 0. */
    void (*marks)(void *context, uint8_t lines);

    /* Switches the range of the current; returns false for one that the board does not have. NULL stands
     * for a board that has the range of its configuration only. */
    bool (*sense_range)(void *context, uint16_t range_ua);

    /* Measure the supply or the temperature. They return false if it is not measured. */
    bool (*supply_mv)(void *context, uint32_t *value);
    bool (*temperature_mk)(void *context, uint32_t *value);

    /* Returns the code of the fault that persists, 0 for none; without it that is the latest code of
     * ta_fault. */
    uint8_t (*fault)(void *context);
} ta_hal;

#endif
