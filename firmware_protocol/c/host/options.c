/* The command line of virtual-amplifier. */
#include <stdio.h>
#include <stdlib.h>

#include "virtual_amplifier.h"

static const char usage[] =
    "usage: virtual-amplifier --pty | --can PATH | --socketcan IFACE | --replay [options]\n"
    "  --pty              serve the serial link on a pseudo-terminal; its path is the first line\n"
    "  --can PATH         serve CAN frames, 72 bytes each, on a Unix datagram socket\n"
    "  --socketcan IFACE  serve CAN frames on an interface of Linux, such as vcan0\n"
    "  --replay           run records from standard input on a virtual clock\n"
    "  --channels N       --carriers N        --formats MASK   --node N\n"
    "  --full-scale-uv N  --voltage-limit-uv N                 --slew-v-per-s N  --fade-us N\n"
    "  --rate-min HZ      --rate-max HZ       --tick-hz N      --fifo N  --packet-limit N\n"
    "  --fd               send CAN FD frames\n"
    "  --extended         29-bit identifiers on CAN\n"
    "  --sense            measure: SENSE gives what was put out\n"
    "  --load-pf LIST     measure what loads draw, such as 12800,0,short: of channels from 0 on, the\n"
    "                     last of all that follow; 0 is an open line\n"
    "  --sense-ranges-ua LIST  measure for CORRELATION, and SENSE, with these ranges of the current, such\n"
    "                     as 2500,20000; that at power-up first\n"
    "  --current-delay N  take these currents as late by so many instants, 0 to 64\n"
    "  --marker-lines N   have so many marker lines, 0 to 8; without it 8 while it serves, 0 in a replay\n"
    "  --link serial|can|i2c|smbus|packet     answer over this link, whatever is fed\n"
    "  --out FILE         a record per instant: u64 tick, u32 position, u8 state,\n"
    "                     u8 high voltage, i16 per channel\n"
    "  --sent FILE        a record per frame sent, and per change of the high voltage and the marker lines:\n"
    "                     u64 tick, u8 kind, u32 length, bytes\n"
    "while it serves, SIGUSR1 pulls the e-stop button and SIGUSR2 releases it\n";

/* Whether the arguments have an option. */
static bool given(int argc, char **argv, const char *name)
{
    int i = 1;
    while (i < argc && strcmp(argv[i], name) != 0) {
        i++;
    }
    return i < argc;
}

/* Of a replay no feature is there that is not asked for; who serves can try what marks do. */
static void defaults(virtual_options *o, bool replay)
{
    memset(o, 0, sizeof *o);
    o->link = -1;
    o->config.node = 1;
    o->config.channels = 24;
    o->config.carriers = 16;
    o->config.formats = 0x0F;
    o->config.packet_limit = TA_PACKET_MAX;
    o->config.fifo_samples = TA_FIFO;
    o->config.tick_hz = 1000000;
    o->config.rate_min_hz = 2500;
    o->config.rate_max_hz = 16000;
    o->config.full_scale_uv = 100000000;
    o->config.voltage_limit_uv = 100000000;
    o->config.slew_limit_v_per_s = 700000;
    o->config.fade_limit_us = 20000;
    o->config.firmware = 0x00010000;
    o->config.marker_lines = replay ? 0 : TA_MARKER_LINES;
    memcpy(o->config.name, "virtual", 7);
}

/* Options with a number: the field that it goes to, by its size. */
typedef struct {
    const char *name;
    void *field;
    size_t size;
} number_option;

static bool store(const number_option *option, const char *text)
{
    char *end;
    unsigned long long value = strtoull(text, &end, 0);
    if (*text == '\0' || *text == '-' || *end != '\0' || value >> (8u * option->size) != 0) {
        fprintf(stderr, "virtual-amplifier: %s %s: no number from 0 to %llu\n", option->name, text,
                (1ULL << (8u * option->size)) - 1u);
        return false;
    }
    switch (option->size) {
    case 1:
        *(uint8_t *)option->field = (uint8_t)value;
        return true;
    case 2:
        *(uint16_t *)option->field = (uint16_t)value;
        return true;
    default:
        *(uint32_t *)option->field = (uint32_t)value;
        return true;
    }
}

/* 1: taken, 0: not a number option, -1: wrong. */
static int take_number(virtual_options *o, const char *name, const char *text)
{
    ta_config *c = &o->config;
    const number_option options[] = {
        {"--channels", &c->channels, 1},
        {"--carriers", &c->carriers, 1},
        {"--node", &c->node, 1},
        {"--marker-lines", &c->marker_lines, 1},
        {"--current-delay", &c->current_delay, 1},
        {"--formats", &c->formats, 2},
        {"--fifo", &c->fifo_samples, 2},
        {"--packet-limit", &c->packet_limit, 2},
        {"--full-scale-uv", &c->full_scale_uv, 4},
        {"--voltage-limit-uv", &c->voltage_limit_uv, 4},
        {"--slew-v-per-s", &c->slew_limit_v_per_s, 4},
        {"--fade-us", &c->fade_limit_us, 4},
        {"--rate-min", &c->rate_min_hz, 4},
        {"--rate-max", &c->rate_max_hz, 4},
        {"--tick-hz", &c->tick_hz, 4},
    };
    for (size_t i = 0; i < sizeof options / sizeof options[0]; i++) {
        if (strcmp(name, options[i].name) == 0) {
            return store(&options[i], text) ? 1 : -1;
        }
    }
    return 0;
}

static bool take_link(virtual_options *o, const char *text)
{
    static const struct {
        const char *name;
        int kind;
    } links[] = {
        {"serial", KIND_SERIAL}, {"can", KIND_CAN},          {"i2c", KIND_I2C_WRITE},
        {"packet", KIND_PACKET}, {"smbus", KIND_SMBUS_WRITE},
    };
    for (size_t i = 0; i < sizeof links / sizeof links[0]; i++) {
        if (strcmp(text, links[i].name) == 0) {
            o->link = links[i].kind;
            return true;
        }
    }
    fprintf(stderr, "virtual-amplifier: --link %s: none of serial can i2c smbus packet\n", text);
    return false;
}

static bool take_load(uint32_t *load_pf, const char *text, size_t length)
{
    if (length == 5 && strncmp(text, "short", length) == 0) {
        *load_pf = VIRTUAL_SHORT;
        return true;
    }
    char *end;
    unsigned long value = strtoul(text, &end, 10);
    *load_pf = (uint32_t)value;
    return *text >= '0' && *text <= '9' && end == text + length && value <= VIRTUAL_LOAD_MAX;
}

/* Commas part them; the last one holds for the channels that follow. */
static bool take_loads(virtual_options *o, const char *text)
{
    for (size_t channel = 0; channel < TA_CHANNELS; channel++) {
        size_t length = strcspn(text, ",");
        if (!take_load(&o->load_pf[channel], text, length)) {
            fprintf(stderr, "virtual-amplifier: --load-pf %.*s: no number from 0 to %u, nor short\n",
                    (int)length, text, VIRTUAL_LOAD_MAX);
            return false;
        }
        text += text[length] == ',' ? length + 1 : 0;
    }
    o->senses = o->loaded = true;
    return true;
}

static bool take_ranges(virtual_options *o, const char *text)
{
    for (size_t i = 0; i < VIRTUAL_RANGES && *text != '\0'; i++) {
        char *end;
        unsigned long value = strtoul(text, &end, 10);
        if (*text < '0' || *text > '9' || value < 1 || value > UINT16_MAX) {
            break;
        }
        o->ranges_ua[i] = (uint16_t)value;
        text = *end == ',' && end[1] != '\0' ? end + 1 : end;
    }
    if (*text != '\0' || o->ranges_ua[0] == 0) {
        fprintf(stderr, "virtual-amplifier: --sense-ranges-ua %s: up to %d numbers from 1 to 65535\n", text,
                VIRTUAL_RANGES);
        return false;
    }
    o->config.sense_range_ua = o->ranges_ua[0];
    o->senses = true;
    return true;
}

static bool take_flag(virtual_options *o, const char *name)
{
    bool *flag = strcmp(name, "--pty") == 0        ? &o->pty
                 : strcmp(name, "--replay") == 0   ? &o->replay
                 : strcmp(name, "--fd") == 0       ? &o->fd
                 : strcmp(name, "--extended") == 0 ? &o->extended
                 : strcmp(name, "--sense") == 0    ? &o->senses
                                                   : NULL;
    if (flag != NULL) {
        *flag = true;
    }
    return flag != NULL;
}

/* An option with a value. */
static bool take_value(virtual_options *o, const char *name, const char *value)
{
    int number = take_number(o, name, value);
    if (number != 0) {
        return number > 0;
    }
    if (strcmp(name, "--link") == 0) {
        return take_link(o, value);
    }
    if (strcmp(name, "--load-pf") == 0) {
        return take_loads(o, value);
    }
    if (strcmp(name, "--sense-ranges-ua") == 0) {
        return take_ranges(o, value);
    }
    const char **text = strcmp(name, "--out") == 0         ? &o->out
                        : strcmp(name, "--sent") == 0      ? &o->sent
                        : strcmp(name, "--can") == 0       ? &o->can_path
                        : strcmp(name, "--socketcan") == 0 ? &o->can_interface
                                                           : NULL;
    if (text == NULL) {
        fprintf(stderr, "virtual-amplifier: unknown option %s\n%s", name, usage);
        return false;
    }
    *text = value;
    return true;
}

bool virtual_parse(virtual_options *o, int argc, char **argv)
{
    defaults(o, given(argc, argv, "--replay"));
    for (int i = 1; i < argc; i++) {
        if (strcmp(argv[i], "--help") == 0) {
            fputs(usage, stdout);
            exit(EXIT_SUCCESS);
        }
        if (take_flag(o, argv[i])) {
            continue;
        }
        if (i + 1 == argc) {
            fprintf(stderr, "virtual-amplifier: %s: unknown, or without a value\n%s", argv[i],
                    usage);
            return false;
        }
        if (!take_value(o, argv[i], argv[i + 1])) {
            return false;
        }
        i++;
    }
    if ((o->pty ? 1 : 0) + (o->replay ? 1 : 0) + (o->can_path != NULL ? 1 : 0) +
            (o->can_interface != NULL ? 1 : 0) !=
        1) {
        fprintf(stderr, "virtual-amplifier: one of --pty, --can, --socketcan and --replay\n%s",
                usage);
        return false;
    }
    return true;
}
