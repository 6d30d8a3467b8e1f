/* The sensor: light of the shared image, through the colour filter, as pixels of the selected format. */
#include <string.h>

#include "producer.h"

/* Channel of a pixel in an even or odd row and column. */
static const int filter_channel[][4] = {
    [FILTER_MONO] = { 1, 1, 1, 1 }, [FILTER_RG] = { 0, 1, 1, 2 }, [FILTER_GR] = { 1, 0, 2, 1 },
    [FILTER_GB] = { 1, 2, 0, 1 },   [FILTER_BG] = { 2, 1, 1, 0 },
};

typedef struct { const uint8_t *pixels; uint32_t width, height, channels, bytes; } Light;

#define INLINED static inline __attribute__((always_inline))

/* One value of the light in 16 bits. */
INLINED uint32_t sample_of(const uint8_t *pixels, size_t pixel, uint32_t channel, uint32_t channels, uint32_t bytes) {
    size_t at = pixel * channels + (channels == 1 ? 0 : channel);
    if (bytes == 1) return (uint32_t)pixels[at] << 8;
    uint16_t value;
    memcpy(&value, pixels + 2 * at, 2);
    return value;
}

static uint32_t sample(const Light *light, size_t pixel, uint32_t channel) {
    return sample_of(light->pixels, pixel, channel, light->channels, light->bytes);
}

/* A row of the image in 16 bits. `channels` and `bytes` are constants at the calls, for speed. */
INLINED void expose_row_of(const uint8_t *row, const Format *format, const int channel[2], uint32_t count, uint16_t *out,
                           uint32_t channels, uint32_t bytes) {
    if (format->samples == 3)
        for (uint32_t i = 0; i < 3 * count; i++) out[i] = (uint16_t)sample_of(row, i / 3, i % 3, channels, bytes);
    else if (format->filter)
        for (uint32_t i = 0; i < count; i++)
            out[i] = (uint16_t)sample_of(row, i, (uint32_t)channel[i & 1], channels, bytes);
    else
        for (uint32_t i = 0; i < count; i++)
            out[i] = (uint16_t)((sample_of(row, i, 0, channels, bytes) + 2 * sample_of(row, i, 1, channels, bytes) +
                                 sample_of(row, i, 2, channels, bytes)) >> 2);
}

static void expose_row(const Light *light, const Format *format, const Frame *frame, uint16_t *const *table,
                       uint32_t row, uint16_t *out) {
    uint32_t y = frame->y + row, x = frame->x, count = frame->width;
    const int *filter = filter_channel[format->filter] + 2 * (y & 1);
    const int channel[2] = { filter[x & 1], filter[~x & 1] };
    const uint8_t *from = light->pixels + ((size_t)y * light->width + x) * light->channels * light->bytes;
    if (light->channels == 3 && light->bytes == 1) expose_row_of(from, format, channel, count, out, 3, 1);
    else if (light->channels == 3) expose_row_of(from, format, channel, count, out, 3, 2);
    else if (light->bytes == 1) expose_row_of(from, format, channel, count, out, 1, 1);
    else expose_row_of(from, format, channel, count, out, 1, 2);
    if (!table) return;
    if (format->samples == 3)
        for (uint32_t i = 0; i < 3 * count; i++) out[i] = table[i % 3][out[i]];
    else
        for (uint32_t i = 0; i < count; i++) out[i] = table[channel[i & 1]][out[i]];
}

/* Packed formats put the pixels' bits one after the other, lowest first, with no gap at the row's end. */
static void write_row(const Format *format, const uint16_t *row, size_t count, size_t first, uint8_t *out) {
    unsigned shift = 16 - format->depth;
    if (format->packed) {
        size_t bit = first * format->depth;
        for (size_t i = 0; i < count; i++, bit += format->depth) {
            uint32_t value = (uint32_t)(row[i] >> shift) << (bit & 7);
            for (size_t at = bit >> 3; value; at++, value >>= 8) out[at] |= (uint8_t)value;
        }
    } else if (format->depth == 8)
        for (size_t i = 0; i < count; i++) out[first + i] = (uint8_t)(row[i] >> 8);
    else
        for (size_t i = 0; i < count; i++) {
            uint16_t value = (uint16_t)(row[i] >> shift);
            memcpy(out + 2 * (first + i), &value, 2);
        }
}

/* Mean of the light, from a grid of 32 x 32 pixels. */
static void measure(const Light *light, double mean[3]) {
    for (uint32_t c = 0; c < 3; c++) {
        uint64_t sum = 0;
        for (uint32_t i = 0; i < 1024; i++) {
            size_t y = (size_t)(i / 32) * light->height / 32, x = (size_t)(i % 32) * light->width / 32;
            sum += sample(light, y * light->width + x, c);
        }
        mean[c] = (double)sum / 1024 / 65535;
    }
}

static void expose_image(const Light *light, const Format *format, Frame *frame, uint16_t *const *table) {
    uint16_t row[3 * MAX_SIDE];
    size_t count = (size_t)frame->width * format->samples;
    if (format->packed) memset(frame->bytes, 0, frame->image_bytes);
    for (uint32_t y = 0; y < frame->height; y++) {
        expose_row(light, format, frame, table, y, row);
        write_row(format, row, count, y * count, frame->bytes);
    }
}

/* Exposes image `requested`, or the newest (0). False if the requested one was overwritten: a process that ran too late
 * has lost the light of that moment, and must not use other light instead. */
bool take_image(Device *device, Frame *frame, const Response *response, uint64_t requested) {
    uint16_t *const *table = response_tables(device, response);
    const Format *format = format_of(frame->format);
    const Image *image = device->image;
    memset(frame->mean, 0, sizeof frame->mean);
    for (int attempt = 0; attempt < 100; attempt++) {
        uint64_t number = requested ? requested : LOAD(image->newest);
        if (!number || !format) break; /* the cap is on */
        const Slot *slot = (const Slot *)((const uint8_t *)image + SLOT_HEADER + number % SLOTS * image->slot_bytes);
        if (LOAD(slot->sequence) == 2 * number) {
            Light light = { (const uint8_t *)slot + SLOT_HEADER, (uint32_t)image->width, (uint32_t)image->height,
                            (uint32_t)slot->channels, (uint32_t)slot->bytes_per_sample };
            bool fits = (light.channels == 1 || light.channels == 3) && (light.bytes == 1 || light.bytes == 2) &&
                        SLOT_HEADER + image->width * image->height * light.channels * light.bytes <= image->slot_bytes;
            if (fits) {
                expose_image(&light, format, frame, table);
                measure(&light, frame->mean);
            }
            __atomic_thread_fence(__ATOMIC_ACQUIRE);
            if (LOAD(slot->sequence) == 2 * number) {
                STORE(device->state->image, number);
                return true;
            }
        }
        if (requested) return false;
    }
    memset(frame->bytes, 0, frame->image_bytes);
    return true;
}
