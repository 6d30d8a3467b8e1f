/* Reading and writing of single registers in the shared state. */
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

void set64(Device *device, uint32_t address, uint64_t value) {
    memcpy(device->state->registers + address, &value, sizeof value);
}

void set_double(Device *device, uint32_t address, double value) {
    memcpy(device->state->registers + address, &value, sizeof value);
}

void set_text(Device *device, uint32_t address, const char *value) {
    size_t length = strnlen(value, 63);
    memcpy(device->state->registers + address, value, length);
}
