/* A board for tests of the core: its packets and codes go nowhere, its currents are 0, and the contact of its
 * e-stop input is a bool. */
#ifndef BOARD_H
#define BOARD_H

#include <string.h>

#include "../tactile_core.h"
#include "../tactile_hal.h"

static inline bool board_send(void *context, const uint8_t *packet, size_t size)
{
    (void)context;
    (void)packet;
    (void)size;
    return true;
}

static inline void board_put_out(void *context, uint64_t tick, uint32_t position, const int16_t *codes)
{
    (void)context;
    (void)tick;
    (void)position;
    (void)codes;
}

static inline void board_high_voltage(void *context, bool on)
{
    (void)context;
    (void)on;
}

static inline bool board_estop_open(void *context)
{
    const bool *open = context;
    return *open;
}

static inline void board_currents(void *context, int16_t *codes)
{
    (void)context;
    memset(codes, 0, TA_CHANNELS * sizeof *codes);
}

static inline void board_marks(void *context, uint8_t lines)
{
    (void)context;
    (void)lines;
}

/* The functions that a board must have; *open says whether its contact is open. */
static inline ta_hal board_hal(bool *open)
{
    ta_hal hal = {.context = open,
                  .send = board_send,
                  .put_out = board_put_out,
                  .marks = board_marks,
                  .high_voltage = board_high_voltage,
                  .estop_open = board_estop_open};
    return hal;
}

#endif
