/* The registers' values at power-on, and those that follow from others. */
#include <math.h>
#include <string.h>

#include "producer.h"

/* The exposure time is a whole number of the sensor's steps. */
static double whole_steps_us(const Device *device, double exposure_us) {
    double step_us = (double)device->state->exposure_step_ns / 1e3;
    double steps = step_us > 0 ? floor(exposure_us / step_us + 0.5) * step_us : exposure_us;
    return steps < step_us ? step_us : steps;
}

static size_t payload_bytes(const Device *device) {
    size_t bytes = image_bytes(get32(device, R_PixelFormat), get32(device, R_Width), get32(device, R_Height));
    if (!get32(device, R_ChunkModeActive)) return bytes;
    bytes = (bytes + 7) & ~(size_t)7;
    for (uint32_t i = 0; i < CHUNKS; i++) bytes += get32(device, R_ChunkEnable + 4 * i) ? 8 : 0;
    return bytes;
}

/* Registers that depend on others. */
void update_derived(Device *device) {
    set64(device, R_PayloadSize, payload_bytes(device));
    STORE(device->state->exposure_ns, (uint64_t)llround(get_double(device, R_ExposureTime) * 1e3));
}

void set_exposure(Device *device, double exposure_us) {
    set_double(device, R_ExposureTime, whole_steps_us(device, exposure_us));
    update_derived(device);
}

/* All registers get their defaults but the name that the user gave to the camera. */
void power_on(Device *device) {
    const State *state = device->state;
    char user_id[64];
    memcpy(user_id, device->state->registers + R_DeviceUserID, sizeof user_id);
    memset(device->state->registers, 0, R_END);
    memcpy(device->state->registers + R_DeviceUserID, user_id, sizeof user_id);
    set_text(device, R_DeviceVendorName, VENDOR);
    set_text(device, R_DeviceModelName, state->model);
    set_text(device, R_DeviceVersion, VERSION);
    set_text(device, R_DeviceFirmwareVersion, VERSION);
    set_text(device, R_DeviceSerialNumber, state->serial);
    set32(device, R_SensorWidth, (uint32_t)state->width);
    set32(device, R_SensorHeight, (uint32_t)state->height);
    set32(device, R_WidthMax, (uint32_t)state->width);
    set32(device, R_HeightMax, (uint32_t)state->height);
    set32(device, R_Width, (uint32_t)state->width);
    set32(device, R_Height, (uint32_t)state->height);
    set32(device, R_SensorFilter, (uint32_t)state->filter);
    set32(device, R_PixelFormat, PF_Mono8);
    set32(device, R_AcquisitionFrameCount, 1);
    set32(device, R_AcquisitionBurstFrameCount, 1);
    set_double(device, R_AcquisitionFrameRate, 30);
    set_double(device, R_ExposureTime, whole_steps_us(device, 5000));
    set_double(device, R_Gamma, 1);
    for (uint32_t c = 0; c < 3; c++) set_double(device, R_BalanceRatio + 8 * c, 1);
    set32(device, R_TriggerSelector, TRIGGER_FRAME);
    set64(device, R_GevTimestampTickFrequency, 1000000000u / OLD_TICK_NS);
    if (state->automatic) {
        set32(device, R_ExposureAuto, AUTO_CONTINUOUS);
        set32(device, R_GainAuto, AUTO_CONTINUOUS);
        set32(device, R_BalanceWhiteAuto, AUTO_CONTINUOUS);
        set32(device, R_GammaEnable, 1);
        set_double(device, R_Gamma, 0.45);
        set32(device, R_AcquisitionFrameRateEnable, 1);
    }
    update_derived(device);
    STORE(device->state->registers_power_cycle, LOAD(state->power_cycles));
}
