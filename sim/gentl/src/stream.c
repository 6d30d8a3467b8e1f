/* The data stream: buffers that the host announces, queues for filling, and gets back filled. */
#include <stdlib.h>
#include <string.h>

#include "producer.h"

enum { OLDEST_FIRST = 1, OLDEST_FIRST_OVERWRITE, NEWEST_ONLY };

#define NEEDS_STREAM(handle) \
    if (!is_kind(handle, STREAM)) return fail(GC_ERR_INVALID_HANDLE, "%s: not an open stream", __func__)

static void push(Queue *queue, Buffer *buffer) { queue->item[queue->count++] = buffer; }

static Buffer *remove_at(Queue *queue, int at) {
    Buffer *buffer = queue->item[at];
    memmove(queue->item + at, queue->item + at + 1, (size_t)(--queue->count - at) * sizeof *queue->item);
    return buffer;
}

static int index_of(const Queue *queue, const void *buffer) {
    for (int i = 0; i < queue->count; i++)
        if (queue->item[i] == buffer) return i;
    return -1;
}

static void to_input(Stream *stream, Buffer *buffer) {
    buffer->queued = true;
    buffer->waiting = false;
    push(&stream->input, buffer);
}

static int handling(const Stream *stream) {
    uint32_t mode;
    memcpy(&mode, stream->registers + S_StreamBufferHandlingMode, sizeof mode);
    return (int)mode;
}

/* Copies as much of the frame as the buffer holds; the lock is held, so it cannot be revoked meanwhile. */
static void fill(Buffer *buffer, const Frame *frame, bool truncate) {
    size_t size = truncate ? frame->image_bytes / 2 : frame->filled;
    if (size > buffer->size) size = buffer->size;
    memcpy(buffer->bytes, frame->bytes, size);
    memset(buffer->bytes + size, 0, buffer->size - size);
    buffer->frame = *frame;
    buffer->frame.bytes = NULL;
    buffer->frame.filled = size;
    buffer->incomplete = size < frame->filled;
    if (buffer->incomplete) buffer->frame.chunks = 0;
    buffer->filled_once = true;
}

Outcome deliver(Stream *stream, const Frame *frame, bool truncate) {
    pthread_mutex_lock(&stream->lock);
    Outcome outcome = NOT_GRABBING;
    if (stream->grabbing) {
        int mode = handling(stream);
        if (!stream->input.count && mode != OLDEST_FIRST && stream->output.count) {
            to_input(stream, remove_at(&stream->output, 0));
            COUNT(stream->device->state->superseded);
        }
        if (stream->input.count) {
            Buffer *buffer = remove_at(&stream->input, 0);
            buffer->queued = false;
            fill(buffer, frame, truncate);
            while (mode == NEWEST_ONLY && stream->output.count) {
                to_input(stream, remove_at(&stream->output, 0));
                COUNT(stream->device->state->superseded);
            }
            buffer->waiting = true;
            push(&stream->output, buffer);
            stream->delivered++;
            stream->fired++;
            outcome = buffer->incomplete ? DELIVERED_INCOMPLETE : DELIVERED;
            pthread_cond_broadcast(&stream->arrived);
        } else {
            stream->underrun++;
            outcome = NO_BUFFER;
        }
    }
    pthread_mutex_unlock(&stream->lock);
    return outcome;
}

void refresh_stream_registers(Stream *stream) {
    uint64_t announced = (uint64_t)stream->announced.count;
    memcpy(stream->registers + S_StreamAnnouncedBufferCount, &announced, 8);
    memcpy(stream->registers + S_StreamDeliveredFrameCount, &stream->delivered, 8);
    memcpy(stream->registers + S_StreamLostFrameCount, &stream->underrun, 8);
}

API GC_ERROR DevGetNumDataStreams(void *handle, uint32_t *count) {
    if (!is_kind(handle, DEVICE)) return fail(GC_ERR_INVALID_HANDLE, "not an open device");
    *count = 1;
    return GC_ERR_SUCCESS;
}

API GC_ERROR DevGetDataStreamID(void *handle, uint32_t index, char *id, size_t *size) {
    if (!is_kind(handle, DEVICE)) return fail(GC_ERR_INVALID_HANDLE, "not an open device");
    if (index) return fail(GC_ERR_INVALID_INDEX, "stream %u: there is one", index);
    return put_text("Stream0", NULL, id, size);
}

API GC_ERROR DevOpenDataStream(void *handle, const char *id, void **out) {
    if (!is_kind(handle, DEVICE)) return fail(GC_ERR_INVALID_HANDLE, "not an open device");
    if (!id || strcmp(id, "Stream0")) return fail(GC_ERR_INVALID_ID, "no such stream");
    Stream *stream = &((Device *)handle)->stream;
    if (stream->open) return fail(GC_ERR_RESOURCE_IN_USE, "the stream is open already");
    uint32_t mode = OLDEST_FIRST;
    memset(stream->registers, 0, sizeof stream->registers);
    memcpy(stream->registers + S_StreamID, "Stream0", 8);
    memcpy(stream->registers + S_StreamBufferHandlingMode, &mode, sizeof mode);
    stream->delivered = stream->underrun = stream->started = stream->fired = 0;
    stream->open = true;
    *out = stream;
    return GC_ERR_SUCCESS;
}

static void discard(Buffer *buffer) {
    if (buffer->own) free(buffer->bytes);
    free(buffer);
}

/* Programs that die half-way leave events registered and buffers announced: both end with the stream. */
void close_stream(Stream *stream) {
    pthread_mutex_lock(&stream->lock);
    stream->open = stream->grabbing = stream->event = stream->killed = false;
    while (stream->announced.count) discard(remove_at(&stream->announced, 0));
    stream->input.count = stream->output.count = 0;
    pthread_cond_broadcast(&stream->arrived);
    pthread_mutex_unlock(&stream->lock);
}

API GC_ERROR DSClose(void *handle) {
    NEEDS_STREAM(handle);
    close_stream(handle);
    return GC_ERR_SUCCESS;
}

API GC_ERROR DSGetParentDev(void *handle, void **device) {
    NEEDS_STREAM(handle);
    *device = ((Stream *)handle)->device;
    return GC_ERR_SUCCESS;
}

static GC_ERROR announce(Stream *stream, void *bytes, size_t size, void *user, bool own, void **out) {
    Buffer *buffer = bytes ? calloc(1, sizeof *buffer) : NULL;
    if (!buffer) return fail(GC_ERR_OUT_OF_MEMORY, "no memory for a buffer of %zu bytes", size);
    *buffer = (Buffer){ .kind = BUFFER, .bytes = bytes, .size = size, .user = user, .own = own };
    pthread_mutex_lock(&stream->lock);
    bool room = stream->announced.count < MAX_BUFFERS;
    if (room) push(&stream->announced, buffer);
    pthread_mutex_unlock(&stream->lock);
    if (!room) {
        free(buffer);
        return fail(GC_ERR_INVALID_PARAMETER, "more than %d buffers", MAX_BUFFERS);
    }
    *out = buffer;
    return GC_ERR_SUCCESS;
}

API GC_ERROR DSAnnounceBuffer(void *handle, void *bytes, size_t size, void *user, void **buffer) {
    NEEDS_STREAM(handle);
    return announce(handle, bytes, size, user, false, buffer);
}

API GC_ERROR DSAllocAndAnnounceBuffer(void *handle, size_t size, void *user, void **buffer) {
    NEEDS_STREAM(handle);
    void *bytes = calloc(1, size);
    GC_ERROR error = announce(handle, bytes, size, user, true, buffer);
    if (error) free(bytes);
    return error;
}

API GC_ERROR DSRevokeBuffer(void *handle, void *which, void **bytes, void **user) {
    NEEDS_STREAM(handle);
    Stream *stream = handle;
    pthread_mutex_lock(&stream->lock);
    int at = index_of(&stream->announced, which);
    Buffer *buffer = at < 0 ? NULL : remove_at(&stream->announced, at);
    if ((at = index_of(&stream->input, which)) >= 0) remove_at(&stream->input, at);
    if ((at = index_of(&stream->output, which)) >= 0) remove_at(&stream->output, at);
    pthread_mutex_unlock(&stream->lock);
    if (!buffer) return fail(GC_ERR_INVALID_HANDLE, "not an announced buffer");
    if (bytes) *bytes = buffer->own ? NULL : buffer->bytes;
    if (user) *user = buffer->user;
    discard(buffer);
    return GC_ERR_SUCCESS;
}

API GC_ERROR DSQueueBuffer(void *handle, void *which) {
    NEEDS_STREAM(handle);
    Stream *stream = handle;
    GC_ERROR error = GC_ERR_SUCCESS;
    pthread_mutex_lock(&stream->lock);
    if (index_of(&stream->announced, which) < 0) error = fail(GC_ERR_INVALID_HANDLE, "not an announced buffer");
    else if (((Buffer *)which)->queued || ((Buffer *)which)->waiting)
        error = fail(GC_ERR_RESOURCE_IN_USE, "the buffer is queued already");
    else to_input(stream, which);
    pthread_mutex_unlock(&stream->lock);
    return error;
}

API GC_ERROR DSFlushQueue(void *handle, int32_t operation) {
    NEEDS_STREAM(handle);
    Stream *stream = handle;
    pthread_mutex_lock(&stream->lock);
    bool discards = operation == ACQ_QUEUE_OUTPUT_DISCARD || operation == ACQ_QUEUE_ALL_DISCARD;
    bool refills = operation == ACQ_QUEUE_ALL_TO_INPUT || operation == ACQ_QUEUE_UNQUEUED_TO_INPUT;
    while (operation != ACQ_QUEUE_INPUT_TO_OUTPUT && operation != ACQ_QUEUE_UNQUEUED_TO_INPUT && stream->output.count)
        remove_at(&stream->output, 0)->waiting = false;
    while (operation == ACQ_QUEUE_ALL_DISCARD && stream->input.count) remove_at(&stream->input, 0)->queued = false;
    while (operation == ACQ_QUEUE_INPUT_TO_OUTPUT && stream->input.count) {
        Buffer *buffer = remove_at(&stream->input, 0);
        buffer->queued = false;
        buffer->waiting = true;
        push(&stream->output, buffer);
    }
    for (int i = 0; refills && i < stream->announced.count; i++) {
        Buffer *buffer = stream->announced.item[i];
        if (!buffer->queued && !buffer->waiting) to_input(stream, buffer);
    }
    pthread_mutex_unlock(&stream->lock);
    return discards || refills || operation == ACQ_QUEUE_INPUT_TO_OUTPUT
               ? GC_ERR_SUCCESS : fail(GC_ERR_INVALID_PARAMETER, "flush operation %d", operation);
}

API GC_ERROR DSStartAcquisition(void *handle, int32_t flags, uint64_t frames) {
    (void)flags;
    (void)frames;
    NEEDS_STREAM(handle);
    Stream *stream = handle;
    if (!is_present(stream->device)) return fail(GC_ERR_IO, "%s is gone", stream->device->id);
    pthread_mutex_lock(&stream->lock);
    bool again = stream->grabbing;
    if (!again) {
        stream->grabbing = true;
        stream->started++;
        stream->delivered = stream->underrun = 0;
    }
    pthread_mutex_unlock(&stream->lock);
    return again ? fail(GC_ERR_RESOURCE_IN_USE, "acquisition runs already") : GC_ERR_SUCCESS;
}

API GC_ERROR DSStopAcquisition(void *handle, int32_t flags) {
    (void)flags;
    NEEDS_STREAM(handle);
    Stream *stream = handle;
    pthread_mutex_lock(&stream->lock);
    bool ran = stream->grabbing;
    stream->grabbing = false;
    pthread_mutex_unlock(&stream->lock);
    return ran ? GC_ERR_SUCCESS : fail(GC_ERR_RESOURCE_IN_USE, "acquisition does not run");
}

API GC_ERROR DSGetInfo(void *handle, int32_t command, int32_t *type, void *out, size_t *size) {
    NEEDS_STREAM(handle);
    const Stream *stream = handle;
    switch (command) {
        case STREAM_INFO_ID: return put_text("Stream0", type, out, size);
        case STREAM_INFO_NUM_DELIVERED: return put_u64(stream->delivered, type, out, size);
        case STREAM_INFO_NUM_UNDERRUN: return put_u64(stream->underrun, type, out, size);
        case STREAM_INFO_NUM_ANNOUNCED: return put_size((size_t)stream->announced.count, type, out, size);
        case STREAM_INFO_NUM_QUEUED: return put_size((size_t)stream->input.count, type, out, size);
        case STREAM_INFO_NUM_AWAIT_DELIVERY: return put_size((size_t)stream->output.count, type, out, size);
        case STREAM_INFO_NUM_STARTED: return put_u64(stream->started, type, out, size);
        case STREAM_INFO_PAYLOAD_SIZE: return put_size(get64(stream->device, R_PayloadSize), type, out, size);
        case STREAM_INFO_IS_GRABBING: return put_bool(stream->grabbing, type, out, size);
        case STREAM_INFO_DEFINES_PAYLOADSIZE: return put_bool(false, type, out, size);
        case STREAM_INFO_TLTYPE: return put_text(TL_TYPE, type, out, size);
        case STREAM_INFO_NUM_CHUNKS_MAX: return put_size(CHUNKS, type, out, size);
        case STREAM_INFO_BUF_ANNOUNCE_MIN:
        case STREAM_INFO_BUF_ALIGNMENT: return put_size(1, type, out, size);
    }
    return fail(GC_ERR_NOT_AVAILABLE, "stream info %d", command);
}

API GC_ERROR DSGetBufferID(void *handle, uint32_t index, void **buffer) {
    NEEDS_STREAM(handle);
    Stream *stream = handle;
    if (index >= (uint32_t)stream->announced.count) return fail(GC_ERR_INVALID_INDEX, "buffer %u", index);
    *buffer = stream->announced.item[index];
    return GC_ERR_SUCCESS;
}
