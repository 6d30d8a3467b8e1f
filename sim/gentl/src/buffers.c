/* Information about filled buffers, and the "new buffer" event. */
#include <string.h>
#include <time.h>

#include "producer.h"

#define NEEDS_STREAM(handle) \
    if (!is_kind(handle, STREAM)) return fail(GC_ERR_INVALID_HANDLE, "%s: not an open stream", __func__)

static bool is_announced(Stream *stream, const void *buffer) {
    bool found = false;
    pthread_mutex_lock(&stream->lock);
    for (int i = 0; i < stream->announced.count; i++) found |= stream->announced.item[i] == buffer;
    pthread_mutex_unlock(&stream->lock);
    return found;
}

API GC_ERROR DSGetBufferInfo(void *handle, void *which, int32_t command, int32_t *type, void *out, size_t *size) {
    NEEDS_STREAM(handle);
    if (!is_announced(handle, which)) return fail(GC_ERR_INVALID_HANDLE, "not an announced buffer");
    const bool old = ((Stream *)handle)->device->state->variant;
    const Buffer *buffer = which;
    const Frame *frame = &buffer->frame;
    switch (command) {
        case BUFFER_INFO_BASE: return put_pointer(buffer->bytes, type, out, size);
        case BUFFER_INFO_SIZE: return put_size(buffer->size, type, out, size);
        case BUFFER_INFO_USER_PTR: return put_pointer(buffer->user, type, out, size);
        case BUFFER_INFO_TIMESTAMP: return put_u64(frame->timestamp, type, out, size);
        case BUFFER_INFO_NEW_DATA: return put_bool(buffer->filled_once, type, out, size);
        case BUFFER_INFO_IS_QUEUED: return put_bool(buffer->queued, type, out, size);
        case BUFFER_INFO_IS_ACQUIRING: return put_bool(false, type, out, size);
        case BUFFER_INFO_IS_INCOMPLETE: return put_bool(buffer->incomplete, type, out, size);
        case BUFFER_INFO_TLTYPE: return put_text(TL_TYPE, type, out, size);
        case BUFFER_INFO_SIZE_FILLED:
        case BUFFER_INFO_DATA_SIZE: return put_size(frame->filled, type, out, size);
        case BUFFER_INFO_WIDTH: return put_size(frame->width, type, out, size);
        case BUFFER_INFO_HEIGHT: return put_size(frame->height, type, out, size);
        case BUFFER_INFO_XOFFSET: return put_size(frame->x, type, out, size);
        case BUFFER_INFO_YOFFSET: return put_size(frame->y, type, out, size);
        case BUFFER_INFO_XPADDING:
        case BUFFER_INFO_YPADDING:
        case BUFFER_INFO_IMAGEOFFSET: return put_size(0, type, out, size);
        case BUFFER_INFO_FRAMEID: return put_u64(frame->frame_id, type, out, size);
        case BUFFER_INFO_IMAGEPRESENT: return put_bool(buffer->filled_once, type, out, size);
        case BUFFER_INFO_PAYLOADTYPE: return put_size(PAYLOAD_TYPE_IMAGE, type, out, size);
        case BUFFER_INFO_PIXELFORMAT: return put_u64(frame->format, type, out, size);
        case BUFFER_INFO_PIXELFORMAT_NAMESPACE: return put_u64(PIXELFORMAT_NAMESPACE_PFNC_32BIT, type, out, size);
        case BUFFER_INFO_DELIVERED_IMAGEHEIGHT:
            return put_size(buffer->incomplete ? frame->height / 2 : frame->height, type, out, size);
        case BUFFER_INFO_DELIVERED_CHUNKPAYLOADSIZE:
            return put_size(frame->chunks ? frame->filled : 0, type, out, size);
        case BUFFER_INFO_PIXEL_ENDIANNESS: return put_i32(PIXELENDIANNESS_LITTLE, type, out, size);
        case BUFFER_INFO_TIMESTAMP_NS:
            if (old) break;
            return put_u64(frame->timestamp, type, out, size);
        case BUFFER_INFO_DATA_LARGER_THAN_BUFFER: return put_bool(frame->image_bytes > buffer->size, type, out, size);
        case BUFFER_INFO_CONTAINS_CHUNKDATA: return put_bool(frame->chunks, type, out, size);
    }
    return fail(GC_ERR_NOT_AVAILABLE, "buffer info %d", command);
}

API GC_ERROR DSGetBufferChunkData(void *handle, void *which, SINGLE_CHUNK_DATA *out, size_t *count) {
    NEEDS_STREAM(handle);
    if (!is_announced(handle, which)) return fail(GC_ERR_INVALID_HANDLE, "not an announced buffer");
    const Frame *frame = &((Buffer *)which)->frame;
    size_t chunks = (size_t)frame->chunks;
    if (out && *count < chunks) return fail(GC_ERR_BUFFER_TOO_SMALL, "%zu chunks, room for %zu", chunks, *count);
    if (out) memcpy(out, frame->chunk, chunks * sizeof *out);
    *count = chunks;
    return GC_ERR_SUCCESS;
}

API GC_ERROR DSGetNumBufferParts(void *handle, void *buffer, uint32_t *parts) {
    (void)buffer;
    (void)parts;
    NEEDS_STREAM(handle);
    return fail(GC_ERR_NOT_AVAILABLE, "no buffer has several parts");
}

API GC_ERROR DSGetBufferPartInfo(
    void *handle, void *buffer, uint32_t part, int32_t command, int32_t *type, void *out, size_t *size) {
    (void)buffer;
    (void)part;
    (void)command;
    (void)type;
    (void)out;
    (void)size;
    NEEDS_STREAM(handle);
    return fail(GC_ERR_NOT_AVAILABLE, "no buffer has several parts");
}

/* Of the events there is only "new buffer"; the event's handle is the stream's. */
API GC_ERROR GCRegisterEvent(void *handle, int32_t event, void **out) {
    if (!handle) return fail(GC_ERR_INVALID_HANDLE, "no handle");
    if (!is_kind(handle, STREAM) || event != EVENT_NEW_BUFFER)
        return fail(GC_ERR_NOT_IMPLEMENTED, "no event %d in this module", event);
    Stream *stream = handle;
    if (stream->event) return fail(GC_ERR_RESOURCE_IN_USE, "the event is registered already");
    stream->event = true;
    stream->killed = false;
    *out = stream;
    return GC_ERR_SUCCESS;
}

API GC_ERROR GCUnregisterEvent(void *handle, int32_t event) {
    (void)event;
    NEEDS_STREAM(handle);
    ((Stream *)handle)->event = false;
    return GC_ERR_SUCCESS;
}

static struct timespec in_ms(uint64_t ms) {
    struct timespec end;
    clock_gettime(CLOCK_MONOTONIC, &end);
    if (ms > 86400000) ms = 86400000; /* "for ever" is a day */
    uint64_t ns = (uint64_t)end.tv_nsec + ms % 1000 * 1000000;
    end.tv_sec += (time_t)(ms / 1000 + ns / 1000000000);
    end.tv_nsec = (long)(ns % 1000000000);
    return end;
}

API GC_ERROR EventGetData(void *handle, void *out, size_t *size, uint64_t timeout_ms) {
    NEEDS_STREAM(handle);
    Stream *stream = handle;
    struct timespec end = in_ms(timeout_ms);
    GC_ERROR error = GC_ERR_SUCCESS;
    pthread_mutex_lock(&stream->lock);
    while (!stream->output.count && !stream->killed && stream->open)
        if (pthread_cond_timedwait(&stream->arrived, &stream->lock, &end)) break;
    if (stream->killed || !stream->open) {
        stream->killed = false;
        error = fail(GC_ERR_ABORT, "the wait was ended");
    } else if (!stream->output.count)
        error = fail(GC_ERR_TIMEOUT, "no buffer within %llu ms", (unsigned long long)timeout_ms);
    else if (*size < sizeof(EVENT_NEW_BUFFER_DATA))
        error = fail(GC_ERR_BUFFER_TOO_SMALL, "%zu bytes needed", sizeof(EVENT_NEW_BUFFER_DATA));
    else {
        Buffer *buffer = stream->output.item[0];
        EVENT_NEW_BUFFER_DATA data = { buffer, buffer->user };
        memmove(stream->output.item, stream->output.item + 1, (size_t)--stream->output.count * sizeof(Buffer *));
        buffer->waiting = false;
        memcpy(out, &data, sizeof data);
        *size = sizeof data;
    }
    pthread_mutex_unlock(&stream->lock);
    return error;
}

API GC_ERROR EventGetDataInfo(
    void *handle, const void *in, size_t in_size, int32_t command, int32_t *type, void *out, size_t *size) {
    NEEDS_STREAM(handle);
    EVENT_NEW_BUFFER_DATA data;
    if (!in || in_size < sizeof data) return fail(GC_ERR_INVALID_PARAMETER, "no event data");
    memcpy(&data, in, sizeof data);
    if (command == EVENT_DATA_ID) return put_pointer(data.BufferHandle, type, out, size);
    if (command == EVENT_DATA_VALUE) return put_pointer(data.pUserPointer, type, out, size);
    return fail(GC_ERR_NOT_AVAILABLE, "event data info %d", command);
}

API GC_ERROR EventGetInfo(void *handle, int32_t command, int32_t *type, void *out, size_t *size) {
    NEEDS_STREAM(handle);
    const Stream *stream = handle;
    switch (command) {
        case EVENT_EVENT_TYPE: return put_i32(EVENT_NEW_BUFFER, type, out, size);
        case EVENT_NUM_IN_QUEUE: return put_size((size_t)stream->output.count, type, out, size);
        case EVENT_NUM_FIRED: return put_u64(stream->fired, type, out, size);
        case EVENT_SIZE_MAX:
        case EVENT_INFO_DATA_SIZE_MAX: return put_size(sizeof(EVENT_NEW_BUFFER_DATA), type, out, size);
    }
    return fail(GC_ERR_NOT_AVAILABLE, "event info %d", command);
}

API GC_ERROR EventFlush(void *handle) {
    NEEDS_STREAM(handle);
    Stream *stream = handle;
    pthread_mutex_lock(&stream->lock);
    for (int i = 0; i < stream->output.count; i++) stream->output.item[i]->waiting = false;
    stream->output.count = 0;
    pthread_mutex_unlock(&stream->lock);
    return GC_ERR_SUCCESS;
}

API GC_ERROR EventKill(void *handle) {
    NEEDS_STREAM(handle);
    Stream *stream = handle;
    pthread_mutex_lock(&stream->lock);
    stream->killed = true;
    pthread_cond_broadcast(&stream->arrived);
    pthread_mutex_unlock(&stream->lock);
    return GC_ERR_SUCCESS;
}
