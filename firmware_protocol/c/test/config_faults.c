/* A filter that says of each configuration on stdin, one a line, which field SPEC.md does not allow, and
 * the least and largest value that it does; "-" where there is none. A line has the numbers of ta_config
 * in its order, whether the board measures currents and has an e-stop input, and the name in hex. */
#include <stdio.h>
#include <stdlib.h>

#include "../tactile_amplifier.h"
#include "board.h"

/* The next number of the line. */
static uint32_t number(char **at)
{
    return (uint32_t)strtoul(*at, at, 10);
}

static void read_name(const char *hex, char *name)
{
    unsigned byte;
    for (size_t i = 0; i < 16 && sscanf(hex + 2 * i, "%2x", &byte) == 1; i++) {
        name[i] = (char)byte;
    }
}

static void read_line(char *at, ta_config *c, ta_hal *hal)
{
    c->node = (uint8_t)number(&at);
    c->channels = (uint8_t)number(&at);
    c->carriers = (uint8_t)number(&at);
    c->formats = (uint16_t)number(&at);
    c->packet_limit = (uint16_t)number(&at);
    c->fifo_samples = (uint16_t)number(&at);
    c->sense_range_ua = (uint16_t)number(&at);
    c->current_delay = (uint8_t)number(&at);
    c->marker_lines = (uint8_t)number(&at);
    c->tick_hz = number(&at);
    c->rate_min_hz = number(&at);
    c->rate_max_hz = number(&at);
    c->full_scale_uv = number(&at);
    c->voltage_limit_uv = number(&at);
    c->slew_limit_v_per_s = number(&at);
    c->fade_limit_us = number(&at);
    hal->currents = number(&at) != 0 ? board_currents : NULL;
    hal->estop_open = number(&at) != 0 ? board_estop_open : NULL;
    read_name(at + 1, c->name);
}

int main(void)
{
    static char line[512];
    while (fgets(line, sizeof line, stdin) != NULL) {
        ta_config config = {0};
        bool open = false;
        ta_hal hal = board_hal(&open);
        ta_bounds bounds;
        read_line(line, &config, &hal);
        const char *field = ta_config_fault(&config, &hal, &bounds);
        printf("%s %u %u\n", field != NULL ? field : "-", bounds.least, bounds.most);
    }
    return EXIT_SUCCESS;
}
