/* virtual-amplifier in real time: CLOCK_MONOTONIC, poll(), and a wire of bytes or datagrams. What is
 * Linux only is in socketcan.c. */
#define _XOPEN_SOURCE 700

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "virtual_amplifier.h"

#define POLL_MS 1
#define HELD_UP_MS 3
#define FRAME_BYTES 72 /* struct canfd_frame: u32 id, u8 length, u8 flags, 2 reserved, 64 data */
#define FRAME_FD 0x04  /* of flags */

static volatile sig_atomic_t stopped;
static volatile sig_atomic_t pulled; /* the e-stop button */

static void on_signal(int number)
{
    (void)number;
    stopped = 1;
}

static void on_button(int number)
{
    pulled = number == SIGUSR1;
}

static void catch_signals(void)
{
    struct sigaction action = {0};
    action.sa_handler = on_signal;
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGINT, &action, NULL);
    action.sa_handler = on_button;
    sigaction(SIGUSR1, &action, NULL);
    sigaction(SIGUSR2, &action, NULL);
}

/* Time */

static struct timespec power_up;

static uint64_t ticks(const virtual_amplifier *v)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    uint64_t ns = (uint64_t)(t.tv_sec - power_up.tv_sec) * 1000000000u +
                  (uint64_t)t.tv_nsec - (uint64_t)power_up.tv_nsec;
    uint64_t hz = v->amp.config.tick_hz;
    return ns / 1000000000u * hz + ns % 1000000000u * hz / 1000000000u;
}

static uint64_t hal_clock(void *context)
{
    return ticks(context);
}

/* The end: to 0 V at the slew limit, as at a fault, on ticks that have not come yet. */
static void power_down(virtual_amplifier *v)
{
    uint64_t tick = ticks(v);
    virtual_run(v, tick);
    ta_fault(&v->amp, TP_FAULT_HARDWARE, tick);
    do {
        virtual_run(v, ta_next_instant(&v->amp));
    } while (!v->amp.player.silent);
}

static void begin(virtual_amplifier *v, uint8_t link, int *fd)
{
    clock_gettime(CLOCK_MONOTONIC, &power_up);
    v->amp.hal.clock = hal_clock;
    v->link = link;
    v->wire = fd;
    catch_signals();
}

/* Whether the system held this process up: a board's clock would not have stood still. */
static bool held_up(const virtual_amplifier *v)
{
    return (ticks(v) - v->tick) * 1000u > (uint64_t)HELD_UP_MS * v->amp.config.tick_hz;
}

/* What waits after the process was held up came meanwhile, where a board's DMA would have taken
 * it: it counts as come before what is overdue. (A TIME among it is answered as received before it
 * was sent; hosts take it as received when it was answered: SPEC.md, 7.2.) */
static void serve(virtual_amplifier *v, void (*receive)(virtual_amplifier *v))
{
    struct pollfd wait = {0};
    const int *fd = v->wire;
    wait.events = POLLIN;
    while (!stopped) {
        wait.fd = *fd;
        int ready = poll(&wait, 1, POLL_MS);
        if (ready > 0 && held_up(v)) {
            receive(v);
            ready = 0;
        }
        virtual_run(v, ticks(v));
        v->estop_open = pulled != 0;
        ta_estop_input(&v->amp, v->tick);
        if (ready > 0 || *fd < 0) {
            receive(v);
        }
    }
    power_down(v);
}

void virtual_serve(virtual_amplifier *v, uint8_t link, int *fd,
                   void (*receive)(virtual_amplifier *v))
{
    begin(v, link, fd);
    serve(v, receive);
}

static bool failed(const char *what)
{
    perror(what);
    return false;
}

/* Pseudo-terminal */

static void receive_bytes(virtual_amplifier *v)
{
    uint8_t bytes[4096];
    const int *fd = v->wire;
    ssize_t got = read(*fd, bytes, sizeof bytes);
    if (got > 0) {
        ta_serial_feed(&v->serial, bytes, (size_t)got, v->tick);
    }
}

/* All or nothing is what the amplifier counts by: a frame that is cut off is lost, and the 0x00 of
 * the next ends it. */
static bool write_bytes(void *context, const uint8_t *bytes, size_t size)
{
    static bool cut_off;
    const int *fd = context;
    const uint8_t zero = 0;
    if (cut_off && write(*fd, &zero, 1) != 1) {
        return false;
    }
    cut_off = false;
    ssize_t wrote = write(*fd, bytes, size);
    cut_off = wrote > 0 && (size_t)wrote < size;
    return wrote == (ssize_t)size;
}

/* As cfmakeraw, which POSIX lacks: bytes pass as they are. */
static bool make_raw(int fd)
{
    struct termios t;
    if (tcgetattr(fd, &t) != 0) {
        return false;
    }
    t.c_iflag &= (tcflag_t) ~(IGNBRK | BRKINT | PARMRK | ISTRIP | INLCR | IGNCR | ICRNL | IXON);
    t.c_oflag &= (tcflag_t)~OPOST;
    t.c_lflag &= (tcflag_t) ~(ECHO | ECHONL | ICANON | ISIG | IEXTEN);
    t.c_cflag = (t.c_cflag & (tcflag_t) ~(CSIZE | PARENB)) | CS8;
    return tcsetattr(fd, TCSANOW, &t) == 0;
}

/* Tell observers where the clock of the amplifier, which its records show, is 0. */
static void print_power_up(void)
{
    printf("powered up at %lld.%09ld s\n", (long long)power_up.tv_sec, power_up.tv_nsec);
    fflush(stdout);
}

/* The slave stays open here, so that a host may come and go. */
bool virtual_serve_pty(virtual_amplifier *v)
{
    int fd = posix_openpt(O_RDWR | O_NOCTTY);
    if (fd < 0 || grantpt(fd) != 0 || unlockpt(fd) != 0) {
        return failed("pseudo-terminal");
    }
    const char *path = ptsname(fd);
    int slave = path != NULL ? open(path, O_RDWR | O_NOCTTY) : -1;
    if (slave < 0 || !make_raw(slave) || fcntl(fd, F_SETFL, O_NONBLOCK) != 0) {
        return failed("pseudo-terminal");
    }
    v->write_bytes = write_bytes;
    begin(v, KIND_SERIAL, &fd);
    printf("%s\n", path);
    print_power_up();
    serve(v, receive_bytes);
    close(slave);
    close(fd);
    return true;
}

/* CAN on a datagram socket */

static struct sockaddr_un host; /* the last sender */
static socklen_t host_size;

static void receive_frames(virtual_amplifier *v)
{
    uint8_t bytes[FRAME_BYTES];
    const int *fd = v->wire;
    struct sockaddr_un from;
    for (;;) {
        socklen_t size = sizeof from;
        ssize_t got = recvfrom(*fd, bytes, sizeof bytes, MSG_DONTWAIT, (struct sockaddr *)&from,
                               &size);
        if (got < 0) {
            return;
        }
        uint32_t id = (uint32_t)tp_get_le(bytes, sizeof bytes, 0, 4);
        bool fd_frame = (bytes[5] & FRAME_FD) != 0;
        if (got == FRAME_BYTES && virtual_feed_frame(v, id, fd_frame, bytes + 8, bytes[4])) {
            host = from;
            host_size = size;
        }
    }
}

static bool write_frame(void *context, const ta_can_frame *frame)
{
    const int *fd = context;
    uint8_t bytes[FRAME_BYTES] = {0};
    tp_put_le(bytes, frame->id | (frame->extended ? VIRTUAL_ID_EXTENDED : 0u), 4);
    bytes[4] = frame->size;
    bytes[5] = frame->fd ? FRAME_FD : 0;
    memcpy(bytes + 8, frame->data, frame->size);
    return host_size > 0 && sendto(*fd, bytes, sizeof bytes, MSG_DONTWAIT,
                                   (const struct sockaddr *)&host, host_size) == FRAME_BYTES;
}

bool virtual_serve_can(virtual_amplifier *v, const char *path)
{
    struct sockaddr_un address = {0};
    int fd = socket(AF_UNIX, SOCK_DGRAM, 0);
    address.sun_family = AF_UNIX;
    if (strlen(path) >= sizeof address.sun_path) {
        fprintf(stderr, "virtual-amplifier: %s: too long for a socket\n", path);
        return false;
    }
    memcpy(address.sun_path, path, strlen(path));
    if (fd < 0 || bind(fd, (const struct sockaddr *)&address, sizeof address) != 0) {
        return failed(path);
    }
    v->write_frame = write_frame;
    begin(v, KIND_CAN, &fd);
    print_power_up();
    serve(v, receive_frames);
    unlink(path);
    close(fd);
    return true;
}
