/* The amplifier on an emulated microcontroller. UART0 is the wire: what the host sends passes the interrupt, the
 * ring, COBS and the CRC-32 of the part, and answers take the same way back. UART1 and, in the other direction, a
 * pipe lead to the board, for which a test stands: it sets the time, so that nothing depends on how fast the
 * emulation runs, and does what the functions of the HAL do. A pipe takes a report at once, a UART byte by byte,
 * which takes ten times as long. Both directions consist of records (host/records.h):
 *
 *   to the part    KIND_POWER_UP     fields of ta_config, u32 each, whether the board measures, and, if there are any,
 *                                    the number of marker lines
 *                  KIND_SERIAL       no content: its length is that of bytes on the wire, which have come at its tick
 *                  KIND_NOTHING, KIND_FAULT, KIND_ESTOP_INPUT     as `virtual-amplifier --replay` takes them
 *   to the board   KIND_SERIAL       the same, of an answer
 *                  KIND_HIGH_VOLTAGE u8, 1: on
 *                  KIND_PUT_OUT      u32 position, u32 sample rate, i16 per channel
 *                  KIND_MARKS        u32 position, u8 marker lines, before the KIND_PUT_OUT at which they change
 *                  KIND_AFTER        u8 state, u8 high voltage
 *                  KIND_DONE         after all that a record has caused; the next record may come
 *   with an answer KIND_CURRENTS     i16 per channel
 *                  KIND_SENSE        u8 channel; i16 voltage, i16 current
 *                  KIND_SENSE_RANGE  u16 range; u8, 1: the board has it
 */
#include <string.h>

#include "../../host/records.h"
#include "../../tactile_link.h"
#include "machine.h"
#include "uart.h"

#define WIRE UART0
#define BOARD UART1
#define PIPE "board"
#define CONTENT_MOST 64u /* bytes of a record to the part */
#define REPORT_MOST (8u + 2u * TA_CHANNELS)
#define CHUNK 64u /* bytes of the wire that are handed over at once, less than most packets */

static ta_amplifier amp;
static ta_serial serial;
static uint64_t tick;
static uint32_t pipe;
static bool contact_open; /* of the e-stop input */

static void fail(const char *why)
{
    machine_print(why);
    machine_print("\n");
    machine_exit(false);
}

/* Reports to the board, in one piece. Without `content`, its `size` bytes come on the wire. */
static void report(uint8_t kind, const uint8_t *content, size_t size)
{
    uint8_t record[RECORD_HEAD + REPORT_MOST];
    size_t length = RECORD_HEAD;
    tp_put_le(record, tick, 8);
    record[8] = kind;
    tp_put_le(record + 9, size, 4);
    if (content != NULL) {
        memcpy(record + length, content, size);
        length += size;
    }
    machine_write(pipe, record, length);
}

/* The HAL */

static bool write_wire(void *context, const uint8_t *bytes, size_t size)
{
    (void)context;
    report(KIND_SERIAL, NULL, size);
    uart_write(WIRE, bytes, size);
    return true;
}

static bool send(void *context, const uint8_t *packet, size_t size)
{
    (void)context;
    return ta_serial_send(&serial, packet, size);
}

static void put_out(void *context, uint64_t at, uint32_t position, const int16_t *codes)
{
    uint8_t content[REPORT_MOST];
    (void)context;
    (void)at;
    tp_put_le(content, position, 4);
    tp_put_le(content + 4, amp.player.rate, 4);
    for (size_t c = 0; c < amp.config.channels; c++) {
        tp_put_le(content + 8u + 2u * c, (uint16_t)codes[c], 2);
    }
    report(KIND_PUT_OUT, content, 8u + 2u * amp.config.channels);
}

static void set_lines(void *context, uint8_t lines)
{
    uint8_t content[5];
    (void)context;
    tp_put_le(content, amp.player.position, 4);
    content[4] = lines;
    report(KIND_MARKS, content, sizeof content);
}

static void after(void *context, uint64_t at, uint8_t state, bool high_voltage)
{
    (void)context;
    (void)at;
    const uint8_t content[] = {state, high_voltage ? 1 : 0};
    report(KIND_AFTER, content, sizeof content);
}

static void switch_voltage(void *context, bool on)
{
    (void)context;
    const uint8_t byte = on ? 1 : 0;
    report(KIND_HIGH_VOLTAGE, &byte, 1);
}

static bool estop_open(void *context)
{
    (void)context;
    return contact_open;
}

/* Waits for a code as an answer. */
static int16_t answer(void)
{
    uint8_t code[2];
    uart_read(BOARD, code, sizeof code);
    return (int16_t)tp_get_le(code, sizeof code, 0, 2);
}

static void sense(void *context, uint8_t channel, int16_t *voltage, int16_t *current_ua)
{
    (void)context;
    report(KIND_SENSE, &channel, 1);
    *voltage = answer();
    *current_ua = answer();
}

static void currents(void *context, int16_t *codes)
{
    (void)context;
    report(KIND_CURRENTS, NULL, 0);
    for (size_t c = 0; c < amp.config.channels; c++) {
        codes[c] = answer();
    }
}

static bool sense_range(void *context, uint16_t range_ua)
{
    (void)context;
    const uint8_t content[] = {(uint8_t)range_ua, (uint8_t)(range_ua >> 8)};
    uint8_t good;
    report(KIND_SENSE_RANGE, content, sizeof content);
    uart_read(BOARD, &good, 1);
    return good != 0;
}

/* Records from the board */

/* Reads the next field of a configuration. */
static uint32_t field(const uint8_t **at)
{
    uint32_t value = (uint32_t)tp_get_le(*at, 4, 0, 4);
    *at += 4;
    return value;
}

static ta_config configuration(const uint8_t **at)
{
    ta_config c = {.firmware = 0x00010000, .name = "virtual"};
    c.node = (uint8_t)field(at);
    c.channels = (uint8_t)field(at);
    c.carriers = (uint8_t)field(at);
    c.formats = (uint16_t)field(at);
    c.packet_limit = (uint16_t)field(at);
    c.fifo_samples = (uint16_t)field(at);
    c.tick_hz = field(at);
    c.rate_min_hz = field(at);
    c.rate_max_hz = field(at);
    c.full_scale_uv = field(at);
    c.voltage_limit_uv = field(at);
    c.slew_limit_v_per_s = field(at);
    c.fade_limit_us = field(at);
    c.sense_range_ua = (uint16_t)field(at);
    return c;
}

static void power_up(const uint8_t *content)
{
    ta_config config = configuration(&content);
    ta_hal hal = {.send = send,
                  .put_out = put_out,
                  .marks = set_lines,
                  .high_voltage = switch_voltage,
                  .estop_open = estop_open,
                  .after = after,
                  .sense_range = sense_range};
    hal.sense = field(&content) != 0 ? sense : NULL;
    config.marker_lines = (uint8_t)field(&content);
    hal.currents = config.sense_range_ua != 0 ? currents : NULL;
    tick = 0;
    contact_open = false;
    const char *refused = ta_config_fault(&config, &hal, NULL);
    if (refused != NULL) {
        fail(refused);
    }
    (void)ta_init(&amp, &config, &hal);
    ta_serial_init(&serial, &amp, write_wire, NULL);
}

/* Instants set the tick on their way, so that reports tell when each was. */
static void run(uint64_t until)
{
    while (ta_next_instant(&amp) <= until) {
        tick = ta_next_instant(&amp);
        ta_run(&amp, tick);
    }
    tick = until;
}

static void receive(size_t size)
{
    uint8_t bytes[CHUNK];
    while (size > 0) {
        size_t part = size < sizeof bytes ? size : sizeof bytes;
        uart_read(WIRE, bytes, part);
        ta_serial_feed(&serial, bytes, part, tick);
        size -= part;
    }
}

static void take(uint8_t kind, const uint8_t *content)
{
    switch (kind) {
    case KIND_POWER_UP:
        power_up(content);
        break;
    case KIND_FAULT:
        ta_fault(&amp, content[0], tick);
        break;
    case KIND_ESTOP_INPUT:
        contact_open = content[0] != 0;
        ta_estop_input(&amp, tick);
        break;
    case KIND_NOTHING:
        break;
    default:
        fail("a record of unknown kind");
    }
}

/* Reads the content of a record; a field that is not sent is 0. */
static void take_content(uint8_t *content, size_t size)
{
    if (size > CONTENT_MOST) {
        fail("a record that is too long");
    }
    memset(content, 0, CONTENT_MOST);
    uart_read(BOARD, content, size);
}

int main(void)
{
    uint8_t head[RECORD_HEAD];
    uint8_t content[CONTENT_MOST];
    uart_begin();
    pipe = machine_open(PIPE);
    for (;;) {
        uart_read(BOARD, head, sizeof head);
        uint64_t until = tp_get_le(head, sizeof head, 0, 8);
        uint8_t kind = head[8];
        size_t size = (size_t)tp_get_le(head, sizeof head, 9, 4);
        if (kind != KIND_SERIAL) {
            take_content(content, size); /* before the answers that instants ask for on the same line */
        }
        if (kind != KIND_POWER_UP) {
            run(until);
        }
        if (kind == KIND_SERIAL) {
            receive(size);
        } else {
            take(kind, content);
        }
        report(KIND_DONE, NULL, 0);
    }
}
