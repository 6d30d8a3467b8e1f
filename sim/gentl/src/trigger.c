/* What an edge on a line, or a software trigger, does: start the acquisition, a burst or an exposure, or nothing.
 * Everything in here runs in the camera's thread with the device's lock held. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "producer.h"

static bool is_on(const Device *device, int trigger) {
    return get32(device, R_TriggerMode + 4 * (uint32_t)trigger);
}

/* The trigger that the camera waits for, or TRIGGERS if it needs none. */
static int waits_for(const Device *device) {
    if (is_on(device, TRIGGER_ACQUISITION) && !device->started) return TRIGGER_ACQUISITION;
    if (is_on(device, TRIGGER_BURST) && device->burst_to_go == 0) return TRIGGER_BURST;
    return is_on(device, TRIGGER_FRAME) ? TRIGGER_FRAME : TRIGGERS;
}

bool runs_free(const Device *device) {
    return LOAD(device->state->acquiring) && waits_for(device) == TRIGGERS;
}

void refresh_armed(Device *device) {
    int trigger = waits_for(device);
    bool line = trigger == TRIGGER_FRAME && get32(device, R_TriggerSource + 4 * TRIGGER_FRAME) != SOURCE_SOFTWARE;
    STORE(device->state->armed, LOAD(device->state->acquiring) && line && is_there(device));
}

/* Edges come nearly in order; one too many for the list is not seen. */
void add_edge(Device *device, Edge edge) {
    if (device->edges == MAX_EDGES) {
        COUNT(device->state->ignored);
        return;
    }
    int at = device->edges++;
    while (at > 0 && device->edge[at - 1].t_ns > edge.t_ns) {
        device->edge[at] = device->edge[at - 1];
        at--;
    }
    device->edge[at] = edge;
}

bool next_edge(Device *device, int64_t now, Edge *edge) {
    if (!device->edges || (LOAD(device->state->real_time) && device->edge[0].t_ns > now)) return false;
    *edge = device->edge[0];
    memmove(device->edge, device->edge + 1, (size_t)--device->edges * sizeof *edge);
    return true;
}

/* Does the edge, as the line's inverter shows it, have the direction that the trigger wants? */
static bool is_wanted(const Device *device, const Edge *edge, int trigger) {
    if (edge->source == SOURCE_SOFTWARE) return edge->trigger == trigger;
    uint32_t line = (uint32_t)(edge->source - SOURCE_LINE0);
    if (get32(device, R_LineMode + 4 * line)) return false; /* an output */
    uint32_t activation = get32(device, R_TriggerActivation + 4 * (uint32_t)trigger);
    int direction = get32(device, R_LineInverter + 4 * line) ? !edge->direction : edge->direction;
    return activation == EDGE_ANY || (int)activation == direction;
}

static int64_t period_ns(const Device *device) {
    double rate_hz = get_double(device, R_AcquisitionFrameRate);
    return get32(device, R_AcquisitionFrameRateEnable) && rate_hz > 0 ? llround(1e9 / rate_hz) : 0;
}

static int64_t longest(int64_t a, int64_t b) { return a > b ? a : b; }

static bool describe(Device *device, Frame *frame) {
    frame->width = get32(device, R_Width);
    frame->height = get32(device, R_Height);
    frame->x = get32(device, R_OffsetX);
    frame->y = get32(device, R_OffsetY);
    frame->format = get32(device, R_PixelFormat);
    frame->image_bytes = image_bytes(frame->format, frame->width, frame->height);
    size_t needed = frame->image_bytes + 8 + 8 * CHUNKS;
    if (needed > frame->capacity) {
        free(frame->bytes);
        frame->bytes = malloc(needed);
        frame->capacity = frame->bytes ? needed : 0;
    }
    return frame->bytes && frame->x + (uint64_t)frame->width <= device->state->width &&
           frame->y + (uint64_t)frame->height <= device->state->height;
}

/* Chunks stand behind the picture, each 8 bytes long. */
static void add_chunks(const Device *device, Frame *frame, double exposure_us) {
    uint64_t missed = LOAD(device->state->missed);
    const void *value[CHUNKS] = { &frame->timestamp, &frame->frame_id, &exposure_us, &missed };
    frame->chunks = 0;
    frame->filled = frame->image_bytes;
    if (!get32(device, R_ChunkModeActive)) return;
    frame->filled = (frame->filled + 7) & ~(size_t)7;
    for (int i = 0; i < CHUNKS; i++) {
        if (!get32(device, R_ChunkEnable + 4 * (uint32_t)i)) continue;
        memcpy(frame->bytes + frame->filled, value[i], 8);
        frame->chunk[frame->chunks++] = (SINGLE_CHUNK_DATA){ 0xA001u + (uint64_t)i, (ptrdiff_t)frame->filled, 8 };
        frame->filled += 8;
    }
}

static void expose_frame(Device *device, int64_t start_ns, int64_t exposure_ns, uint64_t picture) {
    State *state = device->state;
    COUNT(state->exposed);
    if (device->frames_to_go > 0) device->frames_to_go--;
    if (device->burst_to_go > 0) device->burst_to_go--;
    int64_t readout_ns = (int64_t)state->readout_ns;
    device->busy_until_ns = start_ns + longest(longest(exposure_ns, readout_ns), period_ns(device));
    uint64_t frame_id = device->frame_id++;
    Frame *frame = &device->memory[(device->first + device->inside) % MEMORY_FRAMES];
    if (device->inside == MEMORY_FRAMES || !describe(device, frame)) {
        COUNT(state->overrun);
        if (device->frames_to_go == 0) STORE(state->acquiring, 0);
        return;
    }
    int64_t device_ns = device_clock_ns(state, start_ns);
    frame->timestamp = (uint64_t)(state->variant ? device_ns / OLD_TICK_NS : device_ns);
    frame->frame_id = frame_id;
    frame->session = device->session;
    frame->due_ns = LOAD(state->real_time) ? start_ns + exposure_ns + readout_ns : start_ns;
    add_chunks(device, frame, (double)exposure_ns / 1e3);
    STORE(state->inside, (uint64_t)++device->inside);
    Response response = response_of(device, exposure_ns);
    pthread_mutex_unlock(&device->lock); /* only this thread touches the memory; register access need not wait */
    take_picture(device, frame, &response, picture);
    pthread_mutex_lock(&device->lock);
    follow_light(device, frame->mean);
    if (device->frames_to_go == 0) STORE(state->acquiring, 0);
}

static int64_t exposure_ns(const Device *device, const Edge *edge) {
    bool by_width = get32(device, R_ExposureMode) == 1 && edge && edge->source != SOURCE_SOFTWARE;
    return by_width ? edge->width_ns : (int64_t)LOAD(device->state->exposure_ns);
}

/* One edge has one result: a frame, a start that it grants, or a count of why not. */
void judge(Device *device, const Edge *edge) {
    State *state = device->state;
    int trigger = waits_for(device);
    if (!LOAD(state->acquiring) || trigger == TRIGGERS || !is_there(device) ||
        (int)get32(device, R_TriggerSource + 4 * (uint32_t)trigger) != edge->source) {
        if (edge->direction == EDGE_RISING) COUNT(state->ignored); /* a pulse counts once */
    } else if (!is_wanted(device, edge, trigger)) {
        bool never = edge->source != SOURCE_SOFTWARE && get32(device, R_LineMode + 4 * (uint32_t)(edge->source - SOURCE_LINE0));
        if ((never && edge->direction == EDGE_RISING) || edge->source == SOURCE_SOFTWARE) COUNT(state->ignored);
    } else if (trigger == TRIGGER_ACQUISITION) {
        device->started = true;
        COUNT(state->granted);
    } else if (trigger == TRIGGER_BURST) {
        device->burst_to_go = get32(device, R_AcquisitionBurstFrameCount);
        COUNT(state->granted);
    } else if (edge->judged && edge->t_ns < device->busy_until_ns)
        COUNT(state->missed);
    else {
        int64_t delay_ns = llround(get_double(device, R_TriggerDelay + 8 * TRIGGER_FRAME) * 1e3);
        expose_frame(device, edge->t_ns + delay_ns, exposure_ns(device, edge), edge->picture);
    }
    if (edge->answer) STORE(state->answered, edge->answer);
    refresh_armed(device);
}

/* Without a frame trigger the camera exposes as often as it can, or at the rate that was set. */
void free_run(Device *device, int64_t now) {
    if (!runs_free(device)) {
        device->next_free_ns = 0;
        return;
    }
    if (!device->next_free_ns) device->next_free_ns = longest(now, device->busy_until_ns);
    if (now < device->next_free_ns) return;
    expose_frame(device, now, exposure_ns(device, NULL), 0);
    device->next_free_ns = device->busy_until_ns;
    refresh_armed(device);
}
