/* CAN on a raw socket of Linux, on which hosts and other amplifiers are as well. The socket hears
 * everybody but itself; what is not for this amplifier the core leaves out. */
#define _XOPEN_SOURCE 700

#include "virtual_amplifier.h"

#ifdef __linux__

#include <errno.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <sys/socket.h>
#include <unistd.h>

#define REOPENS_PER_S 10u

static struct {
    const char *interface;
    int fd; /* -1 while the interface is gone */
    bool fd_frames;
    uint64_t tick; /* of the last attempt to open it again */
} port;

/* The interface is down, was taken away, or is not there again yet. */
static bool is_gone(int error)
{
    return error == ENETDOWN || error == ENODEV || error == ENXIO;
}

static bool attach(int fd, unsigned index)
{
    struct sockaddr_can address;
    const int on = 1;
    memset(&address, 0, sizeof address);
    address.can_family = AF_CAN;
    address.can_ifindex = (int)index;
    if (port.fd_frames &&
        setsockopt(fd, SOL_CAN_RAW, CAN_RAW_FD_FRAMES, &on, sizeof on) != 0) {
        return false;
    }
    return bind(fd, (const struct sockaddr *)&address, sizeof address) == 0;
}

/* A socket on the interface by its name, since one that comes back has another index; or -1, and
 * errno. */
static int open_interface(void)
{
    unsigned index = if_nametoindex(port.interface);
    int fd = index != 0 ? socket(AF_CAN, SOCK_RAW, CAN_RAW) : -1;
    if (fd >= 0 && !attach(fd, index)) {
        int error = errno;
        close(fd);
        errno = error;
        return -1;
    }
    return fd;
}

/* After a failure: where the interface is gone, says so and leaves it. */
static void leave_if_gone(void)
{
    if (port.fd >= 0 && is_gone(errno)) {
        fprintf(stderr, "virtual-amplifier: %s: %s; waiting for it\n", port.interface,
                strerror(errno));
        close(port.fd);
        port.fd = -1;
    }
}

/* An interface that is there but down lets itself be bound, with ENETDOWN for the socket's error. */
static void reopen(const virtual_amplifier *v)
{
    int error = 0;
    socklen_t size = sizeof error;
    if (v->tick - port.tick < v->amp.config.tick_hz / REOPENS_PER_S) {
        return;
    }
    port.tick = v->tick;
    int fd = open_interface();
    if (fd >= 0 && (getsockopt(fd, SOL_SOCKET, SO_ERROR, &error, &size) != 0 || error != 0)) {
        close(fd);
        fd = -1;
    }
    port.fd = fd;
}

static void receive_frames(virtual_amplifier *v)
{
    struct canfd_frame frame;
    if (port.fd < 0) {
        reopen(v);
        return;
    }
    for (;;) {
        memset(&frame, 0, sizeof frame);
        ssize_t got = recv(port.fd, &frame, sizeof frame, MSG_DONTWAIT);
        if (got < 0) {
            leave_if_gone();
            return;
        }
        if (got == CAN_MTU || got == CANFD_MTU) {
            virtual_feed_frame(v, frame.can_id, got == CANFD_MTU, frame.data, frame.len);
        }
    }
}

static bool write_frame(void *context, const ta_can_frame *frame)
{
    struct canfd_frame out;
    ssize_t size = frame->fd ? CANFD_MTU : CAN_MTU;
    (void)context;
    if (port.fd < 0) {
        return false;
    }
    memset(&out, 0, sizeof out);
    out.can_id = frame->id | (frame->extended ? CAN_EFF_FLAG : 0u);
    out.len = frame->size;
    memcpy(out.data, frame->data, frame->size);
    if (send(port.fd, &out, (size_t)size, MSG_DONTWAIT) == size) {
        return true;
    }
    leave_if_gone();
    return false;
}

bool virtual_serve_socketcan(virtual_amplifier *v, const char *interface)
{
    port.interface = interface;
    port.fd_frames = v->can.fd;
    port.fd = open_interface();
    if (port.fd < 0) {
        fprintf(stderr, "virtual-amplifier: --socketcan %s: %s\n", interface,
                errno == EAFNOSUPPORT || errno == EPROTONOSUPPORT ? "no CAN in this kernel"
                                                                  : strerror(errno));
        return false;
    }
    v->write_frame = write_frame;
    virtual_serve(v, KIND_CAN, &port.fd, receive_frames);
    if (port.fd >= 0) {
        close(port.fd);
    }
    return true;
}

#else

bool virtual_serve_socketcan(virtual_amplifier *v, const char *interface)
{
    (void)v;
    fprintf(stderr, "virtual-amplifier: --socketcan %s: only on Linux\n", interface);
    return false;
}

#endif
