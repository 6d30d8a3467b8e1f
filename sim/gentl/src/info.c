/* Results of the "get info" calls, and the last error of each thread. */
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "producer.h"

static __thread GC_ERROR last_error;
static __thread char last_text[256];

GC_ERROR fail(GC_ERROR code, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(last_text, sizeof last_text, format, arguments);
    va_end(arguments);
    return last_error = code;
}

API GC_ERROR GCGetLastError(GC_ERROR *code, char *text, size_t *size) {
    if (code) *code = last_error;
    return put_text(last_text, NULL, text, size);
}

/* Callers first request the size, without a buffer, then the value. */
GC_ERROR put(const void *value, size_t size, int32_t type, int32_t *out_type, void *out, size_t *out_size) {
    if (out_type) *out_type = type;
    if (!out_size) return fail(GC_ERR_INVALID_PARAMETER, "no pointer to a size");
    if (out && *out_size < size) return fail(GC_ERR_BUFFER_TOO_SMALL, "%zu bytes needed, %zu given", size, *out_size);
    if (out) memcpy(out, value, size);
    *out_size = size;
    return GC_ERR_SUCCESS;
}

GC_ERROR put_text(const char *text, int32_t *type, void *out, size_t *size) {
    return put(text, strlen(text) + 1, TYPE_STRING, type, out, size);
}

GC_ERROR put_bool(bool value, int32_t *type, void *out, size_t *size) {
    bool8_t byte = value;
    return put(&byte, sizeof byte, TYPE_BOOL8, type, out, size);
}

GC_ERROR put_i32(int32_t value, int32_t *type, void *out, size_t *size) {
    return put(&value, sizeof value, TYPE_I32, type, out, size);
}

GC_ERROR put_u32(uint32_t value, int32_t *type, void *out, size_t *size) {
    return put(&value, sizeof value, TYPE_U32, type, out, size);
}

GC_ERROR put_u64(uint64_t value, int32_t *type, void *out, size_t *size) {
    return put(&value, sizeof value, TYPE_U64, type, out, size);
}

GC_ERROR put_size(size_t value, int32_t *type, void *out, size_t *size) {
    return put(&value, sizeof value, TYPE_SIZET, type, out, size);
}

GC_ERROR put_pointer(void *value, int32_t *type, void *out, size_t *size) {
    return put(&value, sizeof value, TYPE_PTR, type, out, size);
}
