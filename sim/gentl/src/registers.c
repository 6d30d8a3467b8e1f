/* The camera's registers: values at power-on, what a write does, and those that change by themselves. They live in
 * the shared state, as in a real camera: what one program has set, the next one finds. */
#include <math.h>
#include <string.h>

#include "producer.h"

uint32_t get32(const Device *device, uint32_t address) {
    uint32_t value;
    memcpy(&value, device->state->registers + address, sizeof value);
    return value;
}

uint64_t get64(const Device *device, uint32_t address) {
    uint64_t value;
    memcpy(&value, device->state->registers + address, sizeof value);
    return value;
}

double get_double(const Device *device, uint32_t address) {
    double value;
    memcpy(&value, device->state->registers + address, sizeof value);
    return value;
}

void set32(Device *device, uint32_t address, uint32_t value) {
    memcpy(device->state->registers + address, &value, sizeof value);
}

static void set64(Device *device, uint32_t address, uint64_t value) {
    memcpy(device->state->registers + address, &value, sizeof value);
}

void set_double(Device *device, uint32_t address, double value) {
    memcpy(device->state->registers + address, &value, sizeof value);
}

static void set_text(Device *device, uint32_t address, const char *value) {
    size_t length = strnlen(value, 63);
    memcpy(device->state->registers + address, value, length);
}

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

static void follow(Device *device) {
    set64(device, R_PayloadSize, payload_bytes(device));
    STORE(device->state->exposure_ns, (uint64_t)llround(get_double(device, R_ExposureTime) * 1e3));
}

void set_exposure(Device *device, double exposure_us) {
    set_double(device, R_ExposureTime, whole_steps_us(device, exposure_us));
    follow(device);
}

/* The name that the user gave to the camera is all it keeps. */
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
    follow(device);
    STORE(device->state->registers_power_cycle, LOAD(state->power_cycles));
}

/* Before a read: whatever is not written by the host. */
void refresh(Device *device) {
    set_double(device, R_DeviceTemperature, device->state->temperature_c);
    set64(device, R_TriggersMissed, LOAD(device->state->missed));
    set64(device, R_FramesSent, device->frame_id);
    for (uint32_t line = 0; line < LINES; line++) /* between pulses all lines are low */
        set32(device, R_LineStatus + 4 * line, get32(device, R_LineInverter + 4 * line));
}

static bool is_locked(uint64_t address) {
    return address == R_Width || address == R_Height || address == R_PixelFormat || address == R_AcquisitionMode ||
           address == R_AcquisitionFrameCount || address == R_ChunkModeActive || address == R_UserSetLoad ||
           (address >= R_ChunkEnable && address < R_ChunkEnable + 4 * CHUNKS);
}

/* GenApi checks limits before it writes; a program that writes past it is refused here. */
static bool is_valid(const Device *device, uint64_t address, uint32_t value) {
    uint32_t width = (uint32_t)device->state->width, height = (uint32_t)device->state->height;
    switch (address) {
        case R_Width: return value >= 16 && value % 4 == 0 && value + (uint64_t)get32(device, R_OffsetX) <= width;
        case R_Height: return value >= 4 && value % 2 == 0 && value + (uint64_t)get32(device, R_OffsetY) <= height;
        case R_OffsetX: return value % 4 == 0 && value + (uint64_t)get32(device, R_Width) <= width;
        case R_OffsetY: return value % 2 == 0 && value + (uint64_t)get32(device, R_Height) <= height;
        case R_PixelFormat: return format_exists(value, device->state->filter);
        case R_TriggerSelector: return value < TRIGGERS;
        case R_LineSelector: return value < LINES;
        case R_BalanceRatioSelector: return value < 3;
        case R_ChunkSelector: return value < CHUNKS;
    }
    return true;
}

static void act(Device *device, uint64_t address) {
    if (address == R_AcquisitionStart) begin_acquisition(device);
    if (address == R_AcquisitionStop) end_acquisition(device);
    if (address == R_TimestampLatch) {
        int64_t device_ns = device_clock_ns(device->state, now_ns());
        set64(device, R_TimestampLatchValue, (uint64_t)(device->state->variant ? device_ns / OLD_TICK_NS : device_ns));
    }
    for (int trigger = 0; trigger < TRIGGERS; trigger++)
        if (address == R_TriggerSoftware + 4 * (uint64_t)trigger) software_trigger(device, trigger);
    if (address == R_ExposureTime) set_exposure(device, get_double(device, R_ExposureTime));
    if (address == R_UserSetLoad) power_on(device); /* the only set is the factory's */
    if (address == R_Gain) set_double(device, R_Gain, round(get_double(device, R_Gain) * 10) / 10);
}

/* The device's lock is held. */
GC_ERROR write_register(Device *device, uint64_t address, const void *value, size_t size) {
    if (address < R_DeviceVendorName || address > R_END || size > R_END - address)
        return fail(GC_ERR_INVALID_ADDRESS, "%zu bytes at 0x%llx", size, (unsigned long long)address);
    if (is_locked(address) && (get32(device, R_TLParamsLocked) || LOAD(device->state->acquiring)))
        return fail(GC_ERR_ACCESS_DENIED, "the register at 0x%llx is locked while acquiring", (unsigned long long)address);
    uint32_t word = 0;
    double number = 0;
    if (size == 4) memcpy(&word, value, 4);
    if (size == 8) memcpy(&number, value, 8);
    bool finite = address != R_ExposureTime || (isfinite(number) && number > 0 && number <= 1e7);
    if ((size == 4 && !is_valid(device, address, word)) || !finite)
        return fail(GC_ERR_INVALID_VALUE, "the register at 0x%llx does not take %u", (unsigned long long)address, word);
    memcpy(device->state->registers + address, value, size);
    act(device, address);
    follow(device);
    refresh_armed(device);
    return GC_ERR_SUCCESS;
}
