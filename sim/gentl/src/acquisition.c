/* The camera's thread, one for each open camera: takes edges from the cable, exposes, and sends frames when due. */
#define _GNU_SOURCE
#include <errno.h>
#include <poll.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include "producer.h"

#define IDLE_NS 100000000  /* longest sleep: a change of the state without a datagram is noticed then */

static void wake(Device *device) {
    uint64_t one = 1;
    if (write(device->wake, &one, sizeof one) < 0 && errno != EAGAIN) fail(GC_ERR_IO, "%s", strerror(errno));
}

/* A pulse is two edges. Without real time they arrive at once, one after the other. */
static void receive(Device *device) {
    Pulse pulse;
    for (ssize_t size; (size = recv(device->socket, &pulse, sizeof pulse, 0)) >= 0;) {
        if (size != sizeof pulse || pulse.magic != PULSE_MAGIC || pulse.line >= LINES || pulse.width_ns < 0) continue;
        Edge edge = {
            .t_ns = pulse.t_ns,
            .width_ns = pulse.width_ns,
            .source = SOURCE_LINE0 + (int)pulse.line,
            .direction = EDGE_RISING,
            .image = pulse.image,
            .busy_check = pulse.busy_check,
        };
        add_edge(device, edge);
        edge.t_ns += pulse.width_ns;
        edge.direction = EDGE_FALLING;
        edge.sequence = pulse.sequence;
        add_edge(device, edge);
    }
}

static void send_frame(Device *device, Frame *frame) {
    State *state = device->state;
    uint64_t *counter = NULL;
    if (frame->session != device->session || !is_present(device)) counter = &state->abandoned;
    else if (frame->overwritten) counter = &state->overwritten;
    else if (LOAD(state->dropped) < LOAD(state->drops_requested)) counter = &state->dropped;
    else {
        bool truncate = LOAD(state->truncated) < LOAD(state->truncations_requested);
        switch (deliver(&device->stream, frame, truncate)) {
            case DELIVERED: counter = &state->delivered; break;
            case DELIVERED_INCOMPLETE: counter = truncate ? &state->truncated : &state->too_small; break;
            case NO_BUFFER: counter = &state->no_buffer; break;
            case NOT_GRABBING: counter = &state->abandoned; break;
        }
    }
    COUNT(*counter);
    device->first = (device->first + 1) % MEMORY_FRAMES;
    STORE(state->inside, (uint64_t)--device->inside);
}

/* When the next frame is to be sent; frames of an acquisition that has ended are sent at once. */
static int64_t due_ns(const Device *device) {
    if (device->memory[device->first].session != device->session) return 0;
    int64_t stalled_until = (int64_t)LOAD(device->state->stall_until_ns);
    int64_t due = device->memory[device->first].due_ns;
    if (!LOAD(device->state->real_time)) due = 0;
    return due > stalled_until ? due : stalled_until;
}

/* Frames in the camera's memory are lost. */
static void abandon(Device *device) {
    State *state = device->state;
    for (; device->inside; device->inside--) COUNT(state->abandoned);
    device->edges = 0;
    device->next_free_ns = 0;
    STORE(state->acquiring, 0);
    STORE(state->armed, 0);
    STORE(state->inside, 0);
}

/* Processes what is due, and returns the time until the next event. */
static int64_t step(Device *device) {
    Edge edge;
    receive(device);
    if (device->held && !is_present(device)) { /* unplugged: no process holds the camera any more */
        abandon(device);
        unlock_device(device);
    }
    if (!device->held) {
        device->edges = 0;
        return IDLE_NS;
    }
    while (next_edge(device, now_ns(), &edge)) {
        apply_edge(device, &edge);
        while (device->inside && due_ns(device) <= now_ns()) send_frame(device, &device->memory[device->first]);
    }
    free_run(device, now_ns());
    int64_t now = now_ns();
    while (device->inside && due_ns(device) <= now) send_frame(device, &device->memory[device->first]);
    int64_t next = now + IDLE_NS;
    if (device->inside && due_ns(device) < next) next = due_ns(device);
    if (device->edges && device->edge[0].t_ns < next) next = device->edge[0].t_ns;
    if (device->next_free_ns && device->next_free_ns < next) next = device->next_free_ns;
    return next > now ? next - now : 0;
}

static void *run(void *argument) {
    Device *device = argument;
    struct pollfd source[2] = { { device->socket, POLLIN, 0 }, { device->wake, POLLIN, 0 } };
    pthread_mutex_lock(&device->lock);
    while (device->running) {
        int64_t pause_ns = step(device);
        pthread_mutex_unlock(&device->lock);
        struct timespec pause = { pause_ns / 1000000000, pause_ns % 1000000000 };
        uint64_t wakes;
        if (ppoll(source, 2, &pause, NULL) > 0 && source[1].revents && read(device->wake, &wakes, sizeof wakes) < 0)
            fail(GC_ERR_IO, "%s", strerror(errno));
        pthread_mutex_lock(&device->lock);
    }
    pthread_mutex_unlock(&device->lock);
    return NULL;
}

/* Acquisition ends with the connection; settings stay until the camera loses power. */
static void reset(Device *device) {
    State *state = device->state;
    device->power_cycle = LOAD(state->power_cycles);
    if (LOAD(state->registers_power_cycle) != device->power_cycle) power_on(device);
    uint32_t unlocked = 0;
    memcpy(state->registers + R_TLParamsLocked, &unlocked, sizeof unlocked);
    STORE(state->acquiring, 0);
    STORE(state->armed, 0);
    STORE(state->inside, 0);
    STORE(state->acknowledged, LOAD(state->requested));
    device->edges = device->first = device->inside = 0;
    device->frame_id = 0;
    device->busy_until_ns = device->next_free_ns = 0;
}

GC_ERROR start_camera(Device *device) {
    sigset_t all, before;
    reset(device);
    device->wake = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    if (device->wake < 0) return fail(GC_ERR_IO, "eventfd: %s", strerror(errno));
    device->running = true;
    sigfillset(&all); /* signals are handled by the host program */
    pthread_sigmask(SIG_SETMASK, &all, &before);
    int error = pthread_create(&device->thread, NULL, run, device);
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    if (!error) return GC_ERR_SUCCESS;
    close(device->wake);
    return fail(GC_ERR_ERROR, "no thread for %s: %s", device->id, strerror(error));
}

void stop_camera(Device *device) {
    pthread_mutex_lock(&device->lock);
    device->running = false;
    pthread_mutex_unlock(&device->lock);
    wake(device);
    pthread_join(device->thread, NULL);
    if (device->held) abandon(device);
    for (int i = 0; i < MEMORY_FRAMES; i++) {
        free(device->memory[i].bytes);
        device->memory[i].bytes = NULL;
        device->memory[i].capacity = 0;
    }
    free_tables(device);
    close(device->wake);
}

void begin_acquisition(Device *device) {
    uint32_t mode = get32(device, R_AcquisitionMode);
    device->frames_to_go = mode == 0 ? -1 : mode == 1 ? 1 : (int64_t)get32(device, R_AcquisitionFrameCount);
    device->burst_to_go = 0;
    device->started = false;
    device->session++;
    device->frame_id = 0;
    STORE(device->state->acquiring, 1);
    wake(device);
}

void end_acquisition(Device *device) {
    device->session++; /* frames in memory belong to the ended session */
    STORE(device->state->acquiring, 0);
    wake(device);
}

void software_trigger(Device *device, int trigger) {
    bool busy_check = LOAD(device->state->real_time);
    Edge edge = { .t_ns = now_ns(), .source = SOURCE_SOFTWARE, .trigger = trigger, .busy_check = busy_check };
    add_edge(device, edge);
    wake(device);
}
