/* What the board does for the amplifier: the whole port is to fill in this struct.
 *
 * All functions are called from where ta_run and ta_receive are called, never from an interrupt of
 * their own, and must not call back into the amplifier.
 */
#ifndef TACTILE_HAL_H
#define TACTILE_HAL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    void *context; /* the first argument of all */

    /* Sends a packet to the host, in most firmware one line: ta_serial_send, ta_can_send or
     * ta_replies_push. False: the link could not take it; it is counted as a dropped reply. */
    bool (*send)(void *context, const uint8_t *packet, size_t size);

    /* Puts the codes of all channels out, as those of the instant `tick`. */
    void (*put_out)(void *context, uint64_t tick, uint32_t position, const int16_t *codes);

    /* Switches the high voltage. Off is never asked for while a code is not 0. */
    void (*high_voltage)(void *context, bool on);

    /* Whether the contact of the e-stop input is open (6.3), in most firmware one line: the level of a
     * pin with a pull-up, at which the contact pulls down. It is read at power-up and at each instant;
     * ta_estop_input reads it between. NULL: there is no input, which above 60 V is not allowed. */
    bool (*estop_open)(void *context);

    /* The rest may be NULL. */

    /* The instant is over: for a display on the board, a logger or a test. */
    void (*after)(void *context, uint64_t tick, uint8_t state, bool high_voltage);

    /* The present tick, for the time of sending in TIME_REPLY; else that of reception. */
    uint64_t (*clock)(void *context);

    /* Lets a person find the board. */
    void (*identify)(void *context, uint8_t seconds);

    /* Measures a channel: sample code and microamperes. With it CAPS says so. */
    void (*sense)(void *context, uint8_t channel, int16_t *voltage, int16_t *current_ua);

    /* Measures the supply or the temperature. False: not measured. */
    bool (*supply_mv)(void *context, uint32_t *value);
    bool (*temperature_mk)(void *context, uint32_t *value);

    /* The code of the fault that persists, 0 for none; else what ta_fault was told last. */
    uint8_t (*fault)(void *context);
} ta_hal;

#endif
