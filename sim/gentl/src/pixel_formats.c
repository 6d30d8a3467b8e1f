/* Pixel formats and the size of their images. */
#include "producer.h"

const Format *format_of(uint32_t number) {
    for (size_t i = 0; i < sizeof formats / sizeof *formats; i++)
        if (formats[i].number == number) return &formats[i];
    return NULL;
}

bool format_exists(uint32_t number, uint64_t filter) {
    const Format *format = format_of(number);
    return format && (format->filter ? format->filter == filter : format->samples == 1 || filter != FILTER_MONO);
}

size_t image_bytes(uint32_t format, uint32_t width, uint32_t height) {
    return ((size_t)width * height * (format >> 16 & 0xFF) + 7) / 8;
}
