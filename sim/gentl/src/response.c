/* From light to pixel values: gain, black level, white balance, gamma, and the automatic functions that a measurement
 * has to switch off. With the settings of power-on the values equal the light. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "producer.h"

#define VALUES 65536
#define BRIGHTNESS 0.5    /* target of the automatic functions */
#define MAX_GAIN_DB 24.0
#define MIN_EXPOSURE_US 20.0
#define MAX_EXPOSURE_US 33000.0

Response response_of(const Device *device, int64_t exposure_ns) {
    uint64_t reference_ns = device->state->reference_exposure_ns;
    double gain = pow(10, get_double(device, R_Gain) / 20);
    if (reference_ns) gain *= (double)exposure_ns / (double)reference_ns;
    Response response = { .black = get_double(device, R_BlackLevel) / 255, .gamma = 1 };
    if (get32(device, R_GammaEnable)) response.gamma = get_double(device, R_Gamma);
    for (uint32_t c = 0; c < 3; c++) response.scale[c] = gain * get_double(device, R_BalanceRatio + 8 * c);
    return response;
}

static bool is_identity(const Response *response) {
    return response->scale[0] == 1 && response->scale[1] == 1 && response->scale[2] == 1 && response->black == 0 &&
           response->gamma == 1;
}

/* One table for each channel, or NULL where the values equal the light. Only the camera's thread calls this. */
uint16_t *const *response_tables(Device *device, const Response *response) {
    if (is_identity(response)) return NULL;
    if (device->table[0] && !memcmp(&device->response, response, sizeof *response)) return device->table;
    for (int c = 0; c < 3; c++) {
        if (!device->table[c]) device->table[c] = malloc(VALUES * sizeof *device->table[c]);
        if (!device->table[c]) {
            free_tables(device);
            return NULL;
        }
        for (int i = 0; i < VALUES; i++) {
            double value = response->scale[c] * i / (VALUES - 1) + response->black;
            if (response->gamma != 1) value = pow(fmax(value, 0), response->gamma);
            device->table[c][i] = (uint16_t)lround(fmin(fmax(value, 0), 1) * (VALUES - 1));
        }
    }
    device->response = *response;
    return device->table;
}

void free_tables(Device *device) {
    for (int c = 0; c < 3; c++) {
        free(device->table[c]);
        device->table[c] = NULL;
    }
}

static double between(double value, double low, double high) {
    return fmin(fmax(value, low), high);
}

static bool automatic(Device *device, uint32_t address) {
    uint32_t mode = get32(device, address);
    if (mode == AUTO_ONCE) set32(device, address, AUTO_OFF); /* complete with this frame */
    return mode != AUTO_OFF;
}

/* After a frame: the automatic functions adjust the settings of the next one. */
void follow_light(Device *device, const double mean[3]) {
    double brightness = fmax((mean[0] + 2 * mean[1] + mean[2]) / 4, 1e-3);
    if (automatic(device, R_BalanceWhiteAuto)) {
        for (uint32_t c = 0; c < 3; c++) /* the mean becomes grey */
            set_double(device, R_BalanceRatio + 8 * c, between(mean[1] / fmax(mean[c], 1e-3), 0.25, 4));
    }
    if (automatic(device, R_GainAuto)) {
        double gain_db = between(20 * log10(BRIGHTNESS / brightness), 0, MAX_GAIN_DB);
        set_double(device, R_Gain, round(gain_db * 10) / 10);
    }
    if (automatic(device, R_ExposureAuto)) {
        double exposure_us = get_double(device, R_ExposureTime) * between(BRIGHTNESS / brightness, 0.5, 2);
        set_exposure(device, between(exposure_us, MIN_EXPOSURE_US, MAX_EXPOSURE_US));
    }
}
