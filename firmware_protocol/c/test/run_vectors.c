/* The core without its amplifier, for tests/test_protocol_vectors_c.py: a command per line on standard
 * input, an answer per line on standard output. Bytes are hex, "-" is none of them.
 *
 *   packet HEX                          type flags node seq payload, or "none"
 *   seal TYPE FLAGS NODE SEQ HEX        the packet
 *   cobs HEX                            the coded packet and its delimiter
 *   serial LIMIT HEX ...                what came out of the chunks: "packet HEX" ... "counters ..."
 *   can LIMIT NODE EXTENDED T ID HEX ...
 *                                       the same of frames, "prompt TYPE HEX" among them
 *   send FD EXTENDED NODE HEX           frames of a packet of the amplifier: ID HEX ...
 *   cut ROOM PADDED ID HEX              fragments of a packet
 *   i2c-write LIMIT HEX ...             as serial, of transfers
 *   i2c-read N HEX ... SIZE ...         N packets wait; what the reads give
 *   smbus-write LIMIT HEX ...           as serial, of blocks
 *   smbus-read N HEX ... COUNT          N packets wait; COUNT blocks
 *   size FORMAT SAMPLES CHANNELS        of the data
 *   decode FORMAT SAMPLES CHANNELS HEX  codes
 *   encode FORMAT SAMPLES CHANNELS CODE ...
 *   sine ANGLE | amplitude CODE | phasor CODE PHASE
 *   correlate N CODE ... N CODE CURRENT ...   codes before the window, and the window; its entry
 *   value POSITION N INCREMENT ... CODE PHASE ...
 */
#include <stdio.h>
#include <stdlib.h>

#include "../tactile_guard.h"
#include "../tactile_link.h"
#include "../tactile_samples.h"
#include "../tactile_spectrum.h"
#include "board.h"

static void show(const uint8_t *bytes, size_t size)
{
    if (size == 0) {
        printf("-");
    }
    for (size_t i = 0; i < size; i++) {
        printf("%02x", bytes[i]);
    }
}

/* The links hand over here first: what they found is shown if it is a packet. */
static void spy_receive(ta_amplifier *amp, const uint8_t *bytes, size_t size, uint64_t now)
{
    uint32_t before = amp->counters.packets;
    ta_receive(amp, bytes, size, now);
    if (amp->counters.packets != before) {
        printf("packet ");
        show(bytes, size);
        printf(" ");
    }
}

static void spy_receive_prompt(ta_amplifier *amp, uint8_t type, const uint8_t *payload,
                               size_t size, uint64_t now)
{
    if (type < TP_ACK) {
        printf("prompt %u ", type);
        show(payload, size);
        printf(" ");
    }
    ta_receive_prompt(amp, type, payload, size, now);
}

#define ta_receive spy_receive
#define ta_receive_prompt spy_receive_prompt
#include "../tactile_link.c"
#undef ta_receive
#undef ta_receive_prompt

#define LONGEST (1u << 20)

static char line[LONGEST];
static uint8_t bytes[65536];
static ta_amplifier amp;

static const char *word(void)
{
    return strtok(NULL, " \n");
}

static unsigned long number(void)
{
    const char *text = word();
    return text == NULL ? 0 : strtoul(text, NULL, 0);
}

static size_t hex(const char *text)
{
    size_t size = 0;
    if (text == NULL || *text == '-') {
        return 0;
    }
    for (; text[0] != '\0' && text[1] != '\0' && size < sizeof bytes; text += 2) {
        char pair[3] = {text[0], text[1], 0};
        bytes[size++] = (uint8_t)strtoul(pair, NULL, 16);
    }
    return size;
}

static void power_up(uint8_t node, size_t limit)
{
    ta_config config = {0};
    static bool open;
    ta_hal hal = board_hal(&open);
    config.node = node;
    config.channels = 2;
    config.formats = 7;
    config.packet_limit = (uint16_t)limit;
    config.fifo_samples = TA_FIFO;
    config.tick_hz = 1000000;
    config.rate_min_hz = 2500;
    config.rate_max_hz = 16000;
    config.full_scale_uv = 100000000;
    config.voltage_limit_uv = 100000000;
    config.slew_limit_v_per_s = 700000;
    config.fade_limit_us = 20000;
    if (!ta_init(&amp, &config, &hal)) {
        printf("no amplifier ");
    }
}

static void counters(void)
{
    const ta_counters *c = &amp.counters;
    printf("counters %u %u %u %u %u %u", c->packets, c->crc_errors, c->malformed, c->oversized,
           c->fragments_dropped, c->unknown_type);
}

static bool show_frame(void *context, const ta_can_frame *frame)
{
    (void)context;
    printf("%u ", frame->id);
    show(frame->data, frame->size);
    printf(" ");
    return true;
}

static void do_packet(void)
{
    ta_packet packet;
    size_t size = hex(word());
    if (!ta_packet_decode(&packet, bytes, size)) {
        printf("none");
        return;
    }
    printf("%u %u %u %u ", packet.type, packet.flags, packet.node, packet.seq);
    show(packet.payload, packet.size);
}

static void do_seal(void)
{
    static uint8_t out[sizeof bytes + TA_OVERHEAD];
    ta_packet packet = {0};
    packet.type = (uint8_t)number();
    packet.flags = (uint8_t)number();
    packet.node = (uint8_t)number();
    packet.seq = (uint8_t)number();
    packet.size = hex(word());
    memcpy(out + TA_HEADER, bytes, packet.size);
    packet.payload = out + TA_HEADER;
    show(out, ta_packet_seal(out, &packet));
}

static void do_cobs(void)
{
    static uint8_t out[TA_COBS_MAX(sizeof bytes) + 1u];
    size_t size = ta_cobs_encode(bytes, hex(word()), out);
    out[size] = 0;
    show(out, size + 1u);
}

static void do_serial(void)
{
    static ta_serial link;
    const char *chunk;
    power_up(1, number());
    ta_serial_init(&link, &amp, NULL, NULL);
    while ((chunk = word()) != NULL) {
        size_t size = hex(chunk);
        ta_serial_feed(&link, bytes, size, 0);
    }
    counters();
}

static void do_can(void)
{
    static ta_can link;
    const char *time;
    size_t limit = number();
    power_up((uint8_t)number(), limit);
    ta_can_init(&link, &amp, false, number() != 0, show_frame, NULL);
    while ((time = word()) != NULL) {
        ta_can_frame frame = {0};
        uint64_t now = strtoull(time, NULL, 0);
        frame.id = (uint32_t)number();
        frame.extended = frame.id > 0x7FFu;
        frame.size = (uint8_t)hex(word());
        frame.fd = frame.size > 8u;
        memcpy(frame.data, bytes, frame.size);
        ta_can_feed(&link, &frame, now);
    }
    ta_reassembly_expire(&link.reassembly, UINT64_MAX);
    counters();
}

static void do_send(void)
{
    static ta_can link;
    bool fd = number() != 0;
    bool extended = number() != 0;
    power_up((uint8_t)number(), TA_PACKET_MAX);
    ta_can_init(&link, &amp, fd, extended, show_frame, NULL);
    size_t size = hex(word());
    ta_can_send(&link, bytes, size);
}

static void do_cut(void)
{
    size_t room = number();
    bool padded = number() != 0;
    uint8_t fragment[64];
    ta_cutter cutter = {0};
    cutter.id = (uint8_t)number();
    cutter.size = hex(word());
    cutter.packet = bytes;
    for (size_t size; (size = ta_cut(&cutter, fragment, room)) != 0;) {
        size_t length = padded ? ta_can_fd_length(size) : size;
        memset(fragment + size, 0, length - size);
        show(fragment, length);
        printf(" ");
    }
}

static void do_i2c_write(void)
{
    const char *transfer;
    power_up(1, number());
    while ((transfer = word()) != NULL) {
        size_t size = hex(transfer);
        ta_i2c_write(&amp, bytes, size, 0);
    }
    counters();
}

static void wait_for_host(ta_replies *replies)
{
    memset(replies, 0, sizeof *replies);
    for (size_t left = number(); left > 0; left--) {
        size_t size = hex(word());
        ta_replies_push(replies, bytes, size);
    }
}

static void do_i2c_read(void)
{
    static ta_replies replies;
    const char *size;
    wait_for_host(&replies);
    while ((size = word()) != NULL) {
        show(bytes, ta_i2c_read(&replies, bytes, strtoul(size, NULL, 0)));
        printf(" ");
    }
}

static void do_smbus_write(void)
{
    static ta_smbus link;
    static ta_replies replies;
    const char *block;
    power_up(1, number());
    ta_smbus_init(&link, &amp, &replies);
    while ((block = word()) != NULL) {
        size_t size = hex(block);
        ta_smbus_write(&link, bytes, size, 0);
    }
    counters();
}

static void do_smbus_read(void)
{
    static ta_smbus link;
    static ta_replies replies;
    power_up(1, TA_PACKET_MAX);
    wait_for_host(&replies);
    ta_smbus_init(&link, &amp, &replies);
    for (size_t left = number(); left > 0; left--) {
        show(bytes, ta_smbus_read(&link, bytes));
        printf(" ");
    }
}

static void do_decode(void)
{
    ta_samples samples = {0};
    samples.format = (uint8_t)number();
    samples.samples = (uint8_t)number();
    samples.channels = (uint8_t)number();
    hex(word());
    samples.data = bytes;
    for (uint8_t at = 0; samples.channels > 0 && at < samples.samples; at++) {
        int16_t codes[255];
        ta_samples_row(&samples, at, codes);
        for (uint8_t channel = 0; channel < samples.channels; channel++) {
            printf("%d ", codes[channel]);
        }
    }
}

static void do_encode(void)
{
    static int16_t codes[65536];
    uint8_t format = (uint8_t)number();
    uint8_t samples = (uint8_t)number();
    uint8_t channels = (uint8_t)number();
    for (size_t i = 0; i < (size_t)samples * channels; i++) {
        const char *text = word();
        codes[i] = (int16_t)(text == NULL ? 0 : atoi(text));
    }
    ta_samples_encode(codes, format, channels, samples, bytes);
    show(bytes, ta_samples_size(format, channels, samples));
}

static void do_value(void)
{
    ta_envelope envelope;
    ta_phasor turns[TA_CARRIERS];
    uint32_t position = (uint32_t)number();
    size_t carriers = number();
    ta_envelope_clear(&envelope);
    if (carriers > TA_CARRIERS) {
        printf("too many");
        return;
    }
    for (size_t i = 0; i < carriers; i++) {
        turns[i] = ta_turn((uint32_t)number() * position);
    }
    for (size_t i = 0; i < carriers; i++) {
        uint8_t amplitude = (uint8_t)number();
        envelope.present[i] = ta_phasor_decode(amplitude, (uint8_t)number());
    }
    printf("%d", ta_envelope_value(&envelope, turns, (uint8_t)carriers));
}

static void do_size(void)
{
    uint8_t format = (uint8_t)number();
    uint8_t samples = (uint8_t)number();
    printf("%zu", ta_samples_size(format, (uint8_t)number(), samples));
}

static void do_sine(void)
{
    uint32_t angle = (uint32_t)number();
    ta_phasor turn = ta_turn(angle);
    printf("%d %d", -turn.q, turn.i);
}

static void do_amplitude(void)
{
    printf("%d", ta_amplitude((uint8_t)number()));
}

static void do_phasor(void)
{
    uint8_t amplitude = (uint8_t)number();
    ta_phasor phasor = ta_phasor_decode(amplitude, (uint8_t)number());
    printf("%d %d", phasor.i, phasor.q);
}

static void do_correlate(void)
{
    static ta_correlator correlator;
    uint8_t entry[TA_ENTRY];
    int16_t code;
    size_t before = number();
    ta_correlator_start(&correlator, 1, 0);
    for (size_t i = 0; i < before; i++) {
        code = (int16_t)number();
        ta_correlator_played(&correlator, &code);
    }
    size_t samples = number();
    ta_correlator_open(&correlator, 0, (uint16_t)samples, 1);
    for (size_t i = 0; i < samples; i++) {
        code = (int16_t)number();
        ta_correlator_played(&correlator, &code);
        code = (int16_t)number();
        bool complete = ta_correlator_add(&correlator, &code) == TA_WINDOW_COMPLETE;
        if (complete != (i + 1 == samples)) {
            printf("not complete ");
        }
    }
    ta_correlator_entry(&ta_correlator_window(&correlator)->sums[0], entry);
    show(entry, sizeof entry);
}

static void do_guard(void)
{
    static ta_correlator correlator;
    static ta_guard guard;
    ta_guard_entry entry;
    int16_t code;
    ta_correlator_start(&correlator, 1, 0);
    ta_guard_start(&guard, 1, 8000);
    if (hex(word()) != TA_GUARD_ENTRY) {
        printf("wrong length ");
    }
    ta_guard_decode(&entry, bytes);
    ta_guard_take(&guard, 0, &entry);
    size_t samples = number();
    for (size_t i = 0; i < samples; i++) {
        code = (int16_t)number();
        ta_correlator_played(&correlator, &code);
        code = (int16_t)number();
        (void)ta_guard_add(&guard, &correlator, &code);
        if (i % TP_GUARD_BLOCK == TP_GUARD_BLOCK - 1) {
            printf("%u ", (unsigned)guard.guards[0].reason);
        }
    }
}

int main(void)
{
    static const struct {
        const char *name;
        void (*run)(void);
    } commands[] = {
        {"packet", do_packet},         {"seal", do_seal},
        {"cobs", do_cobs},             {"serial", do_serial},
        {"can", do_can},               {"send", do_send},
        {"cut", do_cut},               {"i2c-write", do_i2c_write},
        {"i2c-read", do_i2c_read},     {"smbus-write", do_smbus_write},
        {"smbus-read", do_smbus_read}, {"size", do_size},
        {"decode", do_decode},         {"encode", do_encode},
        {"sine", do_sine},             {"amplitude", do_amplitude},
        {"phasor", do_phasor},         {"value", do_value},
        {"correlate", do_correlate},   {"guard", do_guard},
    };
    while (fgets(line, sizeof line, stdin) != NULL) {
        const char *name = strtok(line, " \n");
        size_t i = 0;
        while (i < sizeof commands / sizeof commands[0] && name != NULL &&
               strcmp(name, commands[i].name) != 0) {
            i++;
        }
        if (name == NULL || i == sizeof commands / sizeof commands[0]) {
            printf("unknown");
        } else {
            commands[i].run();
        }
        printf("\n");
        fflush(stdout);
    }
    return 0;
}
