/* An exposure: its frame, its duration, and its way into the camera's memory. All functions run in the camera's thread
 * with the device's lock held. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "producer.h"

static int64_t period_ns(const Device *device) {
    double rate_hz = get_double(device, R_AcquisitionFrameRate);
    return get32(device, R_AcquisitionFrameRateEnable) && rate_hz > 0 ? llround(1e9 / rate_hz) : 0;
}

static int64_t longest(int64_t a, int64_t b) { return a > b ? a : b; }

/* Sets up the next frame from the registers; false if there is no room for it. */
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

/* Chunks follow the image, each 8 bytes long. */
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

/* Starts an exposure. The frame stays in memory until it is due; its chunks and settings are those of now. */
void expose(Device *device, int64_t start_ns, int64_t exposure_ns, uint64_t image) {
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
    frame->frame_id = state->variant ? 1 + frame_id % 65535 : frame_id; /* GigE Vision 1: 16 bits, never 0 */
    frame->session = device->session;
    frame->due_ns = LOAD(state->real_time) ? start_ns + exposure_ns + readout_ns : start_ns;
    add_chunks(device, frame, (double)exposure_ns / 1e3);
    STORE(state->inside, (uint64_t)++device->inside);
    Response response = response_of(device, exposure_ns);
    pthread_mutex_unlock(&device->lock); /* only this thread uses the memory; register access need not wait */
    frame->overwritten = !take_image(device, frame, &response, image);
    pthread_mutex_lock(&device->lock);
    follow_light(device, frame->mean);
    if (device->frames_to_go == 0) STORE(state->acquiring, 0);
}

void expose_on(Device *device, const Edge *edge) {
    bool by_width = get32(device, R_ExposureMode) == EXPOSURE_TRIGGER_WIDTH && edge->source != SOURCE_SOFTWARE;
    int64_t exposure_ns = by_width ? edge->width_ns : (int64_t)LOAD(device->state->exposure_ns);
    int64_t delay_ns = llround(get_double(device, R_TriggerDelay + 8 * TRIGGER_FRAME) * 1e3);
    expose(device, edge->t_ns + delay_ns, exposure_ns, edge->image);
}
