/* The program `virtual-amplifier`: the firmware's core on a computer, behind a pseudo-terminal, behind
 * a socket that carries CAN frames, or fed from a file on a virtual clock. README.md shows how.
 *
 * This file holds the HAL, the files that are written, and main; options.c, replay.c, serve.c and
 * socketcan.c the rest.
 */
#include "virtual_amplifier.h"

#include <stdlib.h>

#define FLUSHES_PER_S 50u

/* The HAL */

static bool put_bytes(void *context, const uint8_t *bytes, size_t size)
{
    virtual_amplifier *v = context;
    virtual_record(v, KIND_SERIAL, bytes, size);
    return v->write_bytes == NULL || v->write_bytes(v->wire, bytes, size);
}

static bool put_frame(void *context, const ta_can_frame *frame)
{
    virtual_amplifier *v = context;
    uint8_t bytes[4 + 64];
    tp_put_le(bytes, frame->id | (frame->extended ? VIRTUAL_ID_EXTENDED : 0u), 4);
    memcpy(bytes + 4, frame->data, frame->size);
    virtual_record(v, KIND_CAN, bytes, 4u + frame->size);
    return v->write_frame == NULL || v->write_frame(v->wire, frame);
}

static bool hal_send(void *context, const uint8_t *packet, size_t size)
{
    virtual_amplifier *v = context;
    switch (v->link) {
    case KIND_SERIAL:
        return ta_serial_send(&v->serial, packet, size);
    case KIND_CAN:
        return ta_can_send(&v->can, packet, size);
    case KIND_PACKET:
        virtual_record(v, KIND_PACKET, packet, size);
        return true;
    default:
        return ta_replies_push(&v->replies, packet, size);
    }
}

static void hal_put_out(void *context, uint64_t tick, uint32_t position, const int16_t *codes)
{
    virtual_amplifier *v = context;
    memcpy(v->codes[1], v->codes[0], sizeof v->codes[0]);
    memcpy(v->codes[0], codes, v->amp.config.channels * sizeof *codes);
    tp_put_le(v->row, tick, 8);
    tp_put_le(v->row + 8, position, 4);
    for (size_t c = 0; c < v->amp.config.channels; c++) {
        tp_put_le(v->row + 14 + 2 * c, (uint64_t)(uint16_t)codes[c], 2);
    }
}

static void hal_marks(void *context, uint8_t lines)
{
    virtual_amplifier *v = context;
    uint8_t content[5];
    tp_put_le(content, v->amp.player.position, 4);
    content[4] = lines;
    virtual_record(v, KIND_MARKS, content, sizeof content);
}

static void flush_out(virtual_amplifier *v)
{
    fflush(v->out);
    v->unflushed = 0;
    v->flushed = v->tick;
}

/* Whole records are flushed, and none waits for long: somebody may read while it runs. */
static void write_row(virtual_amplifier *v, size_t size)
{
    if (v->unflushed + size > VIRTUAL_OUT_BYTES) {
        flush_out(v);
    }
    v->unflushed += fwrite(v->row, 1, size, v->out);
    if (v->tick - v->flushed >= v->amp.config.tick_hz / FLUSHES_PER_S) {
        flush_out(v);
    }
}

static void hal_after(void *context, uint64_t tick, uint8_t state, bool high_voltage)
{
    virtual_amplifier *v = context;
    v->tick = tick;
    v->row[12] = state;
    v->row[13] = high_voltage ? 1 : 0;
    if (v->out != NULL) {
        write_row(v, 14u + 2u * v->amp.config.channels);
    }
}

static void hal_high_voltage(void *context, bool on)
{
    const uint8_t byte = on ? 1 : 0;
    virtual_record(context, KIND_HIGH_VOLTAGE, &byte, 1);
}

static bool hal_estop_open(void *context)
{
    const virtual_amplifier *v = context;
    return v->estop_open;
}

static void hal_identify(void *context, uint8_t seconds)
{
    (void)context;
    fprintf(stderr, "virtual-amplifier: here I am, for %u s\n", (unsigned)seconds);
}

/* C dv/dt [fA] of a change of code from one sample to the next. */
static int64_t load_fa(const virtual_amplifier *v, uint32_t load_pf, int32_t change)
{
    int64_t uv_per_s = (int64_t)change * v->amp.config.full_scale_uv / 32767 * v->amp.player.rate;
    return uv_per_s / 1000 * (int64_t)load_pf;
}

/* The same in whole uA, rounded; no more than a reading tells. */
static int16_t load_current(const virtual_amplifier *v, uint32_t load_pf, int32_t change)
{
    int64_t fa = load_fa(v, load_pf, change);
    int64_t ua = (fa + (fa < 0 ? -500000000 : 500000000)) / 1000000000;
    return (int16_t)(ua > INT16_MAX ? INT16_MAX : ua < -INT16_MAX ? -INT16_MAX : ua);
}

/* Without a load what was put out is measured, at no current; with one the middle between the last
 * two samples, and the current of the step between them. A short keeps the voltage at 0 V and draws
 * the most that a reading tells. */
static void hal_sense(void *context, uint8_t channel, int16_t *voltage, int16_t *current_ua)
{
    const virtual_amplifier *v = context;
    int32_t last = v->codes[0][channel];
    int32_t before = v->codes[1][channel];
    *voltage = (int16_t)last;
    *current_ua = 0;
    if (v->loaded && v->load_pf[channel] == VIRTUAL_SHORT) {
        *voltage = 0;
        *current_ua = last > 0 ? INT16_MAX : last < 0 ? -INT16_MAX : 0;
    } else if (v->loaded) {
        *voltage = (int16_t)((last + before) / 2);
        *current_ua = load_current(v, v->load_pf[channel], last - before);
    }
}

/* The same as a current code, at the end of the range where the load draws more. */
static int16_t current_code(const virtual_amplifier *v, size_t channel)
{
    int32_t last = v->codes[0][channel];
    int64_t full_pa = (int64_t)v->range_ua * 1000000;
    if (!v->loaded) {
        return 0;
    }
    if (v->load_pf[channel] == VIRTUAL_SHORT) {
        return (int16_t)(last > 0 ? INT16_MAX : last < 0 ? -INT16_MAX : 0);
    }
    int64_t pa = load_fa(v, v->load_pf[channel], last - v->codes[1][channel]) / 1000;
    if (pa > full_pa || pa < -full_pa) {
        return (int16_t)(pa > 0 ? INT16_MAX : -INT16_MAX);
    }
    return (int16_t)(pa * INT16_MAX / full_pa);
}

static void hal_currents(void *context, int16_t *codes)
{
    const virtual_amplifier *v = context;
    for (size_t c = 0; c < v->amp.config.channels; c++) {
        codes[c] = current_code(v, c);
    }
}

static bool hal_sense_range(void *context, uint16_t range_ua)
{
    virtual_amplifier *v = context;
    for (size_t i = 0; i < VIRTUAL_RANGES; i++) {
        if (v->ranges_ua[i] == range_ua) {
            v->range_ua = range_ua;
            return true;
        }
    }
    return false;
}

/* Files */

void virtual_record(virtual_amplifier *v, uint8_t kind, const uint8_t *bytes, size_t size)
{
    uint8_t head[RECORD_HEAD];
    if (v->sent == NULL) {
        return;
    }
    tp_put_le(head, v->tick, 8);
    head[8] = kind;
    tp_put_le(head + 9, size, 4);
    fwrite(head, 1, sizeof head, v->sent);
    if (size > 0) {
        fwrite(bytes, 1, size, v->sent);
    }
}

static bool open_file(FILE **file, const char *path)
{
    *file = path != NULL ? fopen(path, "wb") : NULL;
    if (path != NULL && *file == NULL) {
        perror(path);
        return false;
    }
    return true;
}

static bool close_file(FILE *file)
{
    if (file == NULL) {
        return true;
    }
    bool good = ferror(file) == 0;
    return fclose(file) == 0 && good;
}

bool virtual_open(virtual_amplifier *v, const virtual_options *options)
{
    ta_hal hal = {0};
    memset(v, 0, sizeof *v);
    hal.context = v;
    hal.send = hal_send;
    hal.put_out = hal_put_out;
    hal.marks = hal_marks;
    hal.high_voltage = hal_high_voltage;
    hal.after = hal_after;
    hal.estop_open = hal_estop_open;
    hal.identify = hal_identify;
    hal.sense = options->senses ? hal_sense : NULL;
    hal.currents = options->ranges_ua[0] != 0 ? hal_currents : NULL;
    hal.sense_range = hal_sense_range;
    if (!ta_init(&v->amp, &options->config, &hal)) {
        virtual_explain(&options->config, &hal);
        return false;
    }
    ta_serial_init(&v->serial, &v->amp, put_bytes, v);
    ta_can_init(&v->can, &v->amp, options->fd, options->extended, put_frame, v);
    ta_smbus_init(&v->smbus, &v->amp, &v->replies);
    v->loaded = options->loaded;
    memcpy(v->load_pf, options->load_pf, sizeof v->load_pf);
    memcpy(v->ranges_ua, options->ranges_ua, sizeof v->ranges_ua);
    v->range_ua = options->ranges_ua[0];
    v->fixed_link = options->link >= 0;
    v->link = v->fixed_link ? (uint8_t)options->link : (uint8_t)KIND_PACKET;
    return open_file(&v->out, options->out) && open_file(&v->sent, options->sent) &&
           (v->out == NULL || setvbuf(v->out, v->waiting, _IOFBF, sizeof v->waiting) == 0);
}

bool virtual_close(virtual_amplifier *v)
{
    bool out = close_file(v->out);
    bool sent = close_file(v->sent);
    return out && sent;
}

/* Instants set v->tick on their way; what is sent between them is of `tick`. */
void virtual_run(virtual_amplifier *v, uint64_t tick)
{
    while (ta_next_instant(&v->amp) <= tick) {
        v->tick = ta_next_instant(&v->amp);
        ta_run(&v->amp, v->tick);
    }
    v->tick = tick;
    ta_reassembly_expire(&v->can.reassembly, tick);
    ta_reassembly_expire(&v->smbus.reassembly, tick);
}

bool virtual_feed_frame(virtual_amplifier *v, uint32_t id, bool fd, const uint8_t *data,
                        size_t size)
{
    ta_can_frame frame = {0};
    if (size > sizeof frame.data || (id & VIRTUAL_ID_REMOTE) != 0) {
        return false;
    }
    frame.id = id & 0x1FFFFFFFu;
    frame.extended = (id & VIRTUAL_ID_EXTENDED) != 0;
    frame.fd = fd;
    frame.size = (uint8_t)size;
    memcpy(frame.data, data, size);
    ta_can_feed(&v->can, &frame, v->tick);
    return true;
}

int main(int argc, char **argv)
{
    static virtual_amplifier v;
    virtual_options options;
    bool good;
    if (!virtual_parse(&options, argc, argv) || !virtual_open(&v, &options)) {
        return EXIT_FAILURE;
    }
    if (options.replay) {
        good = virtual_replay(&v, stdin);
    } else if (options.pty) {
        good = virtual_serve_pty(&v);
    } else if (options.can_interface != NULL) {
        good = virtual_serve_socketcan(&v, options.can_interface);
    } else {
        good = virtual_serve_can(&v, options.can_path);
    }
    return virtual_close(&v) && good ? EXIT_SUCCESS : EXIT_FAILURE;
}
