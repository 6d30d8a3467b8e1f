/* Access to the camera's registers by the host. They are kept in the shared state, as in a real camera: what a program
 * has set, the next one finds. */
#include <math.h>
#include <string.h>

#include "producer.h"

/* Before a read: update the registers that the host does not write. */
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

/* GenApi checks limits before it writes; a program that bypasses it is rejected here. */
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
    if (address == R_UserSetLoad) power_on(device); /* the only set is the default one */
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
    update_derived(device);
    refresh_armed(device);
    return GC_ERR_SUCCESS;
}
