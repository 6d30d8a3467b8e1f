/* The upper modules: the library itself, its one interface, and the list of devices. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdio.h>
#include <string.h>

#include "producer.h"

#define INTERFACE_ID "FringedInterface"

static pthread_mutex_t library = PTHREAD_MUTEX_INITIALIZER;

#define NEEDS(handle, kind) \
    if (!is_kind(handle, kind)) return fail(GC_ERR_INVALID_HANDLE, "%s: not a valid handle of this kind", __func__)

API GC_ERROR GCInitLib(void) {
    pthread_mutex_lock(&library);
    bool again = the_system.initialised;
    if (!again) {
        for (int i = 0; i < (int)MAX_CAMERAS; i++) {
            Device *device = &devices[i];
            memset(device, 0, sizeof *device);
            device->kind = DEVICE;
            device->port.kind = PORT;
            device->index = i;
            device->fd = device->socket = device->wake = -1;
            snprintf(device->id, sizeof device->id, "FringedCam_%d", i);
            pthread_mutex_init(&device->lock, NULL);
            pthread_condattr_t monotonic;
            pthread_condattr_init(&monotonic);
            pthread_condattr_setclock(&monotonic, CLOCK_MONOTONIC);
            device->stream.kind = STREAM;
            device->stream.device = device;
            pthread_mutex_init(&device->stream.lock, NULL);
            pthread_cond_init(&device->stream.arrived, &monotonic);
            pthread_condattr_destroy(&monotonic);
        }
        the_system.initialised = true;
    }
    pthread_mutex_unlock(&library);
    return again ? fail(GC_ERR_RESOURCE_IN_USE, "the library is in use in this process already") : GC_ERR_SUCCESS;
}

static void close_device(Device *device) {
    if (!device->open) return;
    stop_camera(device);
    close_stream(&device->stream);
    device->open = false;
    release_device(device);
}

API GC_ERROR GCCloseLib(void) {
    if (!the_system.initialised) return fail(GC_ERR_NOT_INITIALIZED, "the library is not initialised");
    for (int i = 0; i < (int)MAX_CAMERAS; i++) {
        close_device(&devices[i]);
        unmap_state(&devices[i]);
    }
    the_system.initialised = the_system.open = the_interface.open = false;
    return GC_ERR_SUCCESS;
}

static GC_ERROR system_info(int32_t command, int32_t *type, void *out, size_t *size) {
    Dl_info library_file;
    switch (command) {
        case TL_INFO_ID:
        case TL_INFO_VENDOR: return put_text(VENDOR, type, out, size);
        case TL_INFO_MODEL:
        case TL_INFO_DISPLAYNAME: return put_text("Fringed emulated cameras", type, out, size);
        case TL_INFO_VERSION: return put_text(VERSION, type, out, size);
        case TL_INFO_TLTYPE: return put_text(TL_TYPE, type, out, size);
        case TL_INFO_NAME: return put_text("fringed.cti", type, out, size);
        case TL_INFO_PATHNAME:
            if (!dladdr(&devices, &library_file) || !library_file.dli_fname) break;
            return put_text(library_file.dli_fname, type, out, size);
        case TL_INFO_CHAR_ENCODING: return put_i32(1, type, out, size); /* UTF-8 */
        case TL_INFO_GENTL_VER_MAJOR: return put_u32(1, type, out, size);
        case TL_INFO_GENTL_VER_MINOR: return put_u32(5, type, out, size);
    }
    return fail(GC_ERR_NOT_AVAILABLE, "system info %d", command);
}

API GC_ERROR GCGetInfo(int32_t command, int32_t *type, void *out, size_t *size) {
    return system_info(command, type, out, size);
}

API GC_ERROR TLOpen(void **handle) {
    if (!the_system.initialised) return fail(GC_ERR_NOT_INITIALIZED, "call GCInitLib first");
    if (the_system.open) return fail(GC_ERR_RESOURCE_IN_USE, "the system is open already");
    the_system.open = true;
    *handle = &the_system;
    return GC_ERR_SUCCESS;
}

API GC_ERROR TLClose(void *handle) {
    NEEDS(handle, SYSTEM);
    the_system.open = false;
    return GC_ERR_SUCCESS;
}

API GC_ERROR TLGetInfo(void *handle, int32_t command, int32_t *type, void *out, size_t *size) {
    NEEDS(handle, SYSTEM);
    return system_info(command, type, out, size);
}

API GC_ERROR TLGetNumInterfaces(void *handle, uint32_t *count) {
    NEEDS(handle, SYSTEM);
    *count = 1;
    return GC_ERR_SUCCESS;
}

API GC_ERROR TLGetInterfaceID(void *handle, uint32_t index, char *id, size_t *size) {
    NEEDS(handle, SYSTEM);
    if (index) return fail(GC_ERR_INVALID_INDEX, "interface %u: there is one", index);
    return put_text(INTERFACE_ID, NULL, id, size);
}

static GC_ERROR interface_info(int32_t command, int32_t *type, void *out, size_t *size) {
    switch (command) {
        case INTERFACE_INFO_ID: return put_text(INTERFACE_ID, type, out, size);
        case INTERFACE_INFO_DISPLAYNAME: return put_text("Fringed emulated bus", type, out, size);
        case INTERFACE_INFO_TLTYPE: return put_text(TL_TYPE, type, out, size);
    }
    return fail(GC_ERR_NOT_AVAILABLE, "interface info %d", command);
}

API GC_ERROR TLGetInterfaceInfo(void *handle, const char *id, int32_t command, int32_t *type, void *out, size_t *size) {
    NEEDS(handle, SYSTEM);
    if (!id || strcmp(id, INTERFACE_ID)) return fail(GC_ERR_INVALID_ID, "no such interface");
    return interface_info(command, type, out, size);
}

API GC_ERROR TLOpenInterface(void *handle, const char *id, void **interface) {
    NEEDS(handle, SYSTEM);
    if (!id || strcmp(id, INTERFACE_ID)) return fail(GC_ERR_INVALID_ID, "no such interface");
    if (the_interface.open) return fail(GC_ERR_RESOURCE_IN_USE, "the interface is open already");
    the_interface.open = true;
    *interface = &the_interface;
    return GC_ERR_SUCCESS;
}

API GC_ERROR TLUpdateInterfaceList(void *handle, bool8_t *changed, uint64_t timeout_ms) {
    (void)timeout_ms;
    NEEDS(handle, SYSTEM);
    if (changed) *changed = 0;
    return GC_ERR_SUCCESS;
}

API GC_ERROR IFClose(void *handle) {
    NEEDS(handle, INTERFACE);
    the_interface.open = false;
    return GC_ERR_SUCCESS;
}

API GC_ERROR IFGetInfo(void *handle, int32_t command, int32_t *type, void *out, size_t *size) {
    NEEDS(handle, INTERFACE);
    return interface_info(command, type, out, size);
}

API GC_ERROR IFGetParentTL(void *handle, void **system) {
    NEEDS(handle, INTERFACE);
    *system = &the_system;
    return GC_ERR_SUCCESS;
}

/* The list stays as at the last update, whatever was plugged or unplugged since. */
API GC_ERROR IFUpdateDeviceList(void *handle, bool8_t *changed, uint64_t timeout_ms) {
    (void)timeout_ms;
    NEEDS(handle, INTERFACE);
    bool differs = false;
    scan(devices);
    for (int i = 0; i < (int)MAX_CAMERAS; i++) {
        bool listed = devices[i].state && LOAD(devices[i].state->present);
        differs |= listed != devices[i].listed;
        devices[i].listed = listed;
    }
    if (changed) *changed = differs;
    return GC_ERR_SUCCESS;
}

API GC_ERROR IFGetNumDevices(void *handle, uint32_t *count) {
    NEEDS(handle, INTERFACE);
    *count = 0;
    for (int i = 0; i < (int)MAX_CAMERAS; i++) *count += devices[i].listed;
    return GC_ERR_SUCCESS;
}

API GC_ERROR IFGetDeviceID(void *handle, uint32_t index, char *id, size_t *size) {
    NEEDS(handle, INTERFACE);
    uint32_t left = index;
    for (int i = 0; i < (int)MAX_CAMERAS; i++)
        if (devices[i].listed && left-- == 0) return put_text(devices[i].id, NULL, id, size);
    return fail(GC_ERR_INVALID_INDEX, "device %u: there are fewer devices", index);
}

static Device *find(const char *id) {
    for (int i = 0; i < (int)MAX_CAMERAS; i++)
        if (id && devices[i].listed && !strcmp(devices[i].id, id)) return &devices[i];
    return NULL;
}

static GC_ERROR device_info(const Device *device, int32_t command, int32_t *type, void *out, size_t *size) {
    const State *state = device->state;
    char name[160];
    int status = device->open ? DEVICE_ACCESS_STATUS_OPEN_READWRITE : DEVICE_ACCESS_STATUS_READWRITE;
    switch (command) {
        case DEVICE_INFO_ID: return put_text(device->id, type, out, size);
        case DEVICE_INFO_VENDOR: return put_text(VENDOR, type, out, size);
        case DEVICE_INFO_MODEL: return put_text(state->model, type, out, size);
        case DEVICE_INFO_TLTYPE: return put_text(TL_TYPE, type, out, size);
        case DEVICE_INFO_DISPLAYNAME:
            snprintf(name, sizeof name, "%s (%s)", state->model, state->serial);
            return put_text(name, type, out, size);
        case DEVICE_INFO_ACCESS_STATUS:
            return put_i32(is_locked_elsewhere(device) ? DEVICE_ACCESS_STATUS_BUSY : status, type, out, size);
        case DEVICE_INFO_USER_DEFINED_NAME:
            memcpy(name, state->registers + R_DeviceUserID, 64);
            name[63] = 0;
            return put_text(name, type, out, size);
        case DEVICE_INFO_SERIAL_NUMBER: return put_text(state->serial, type, out, size);
        case DEVICE_INFO_VERSION: return put_text(VERSION, type, out, size);
        case DEVICE_INFO_TIMESTAMP_FREQUENCY:
            return put_u64(1000000000u / (state->variant ? OLD_TICK_NS : 1), type, out, size);
    }
    return fail(GC_ERR_NOT_AVAILABLE, "device info %d", command);
}

API GC_ERROR IFGetDeviceInfo(void *handle, const char *id, int32_t command, int32_t *type, void *out, size_t *size) {
    NEEDS(handle, INTERFACE);
    const Device *device = find(id);
    if (!device) return fail(GC_ERR_INVALID_ID, "no device %s", id ? id : "(null)");
    return device_info(device, command, type, out, size);
}

API GC_ERROR IFOpenDevice(void *handle, const char *id, int32_t flags, void **out) {
    (void)flags;
    NEEDS(handle, INTERFACE);
    Device *device = find(id);
    if (!device) return fail(GC_ERR_INVALID_ID, "no device %s", id ? id : "(null)");
    if (device->open) return fail(GC_ERR_RESOURCE_IN_USE, "%s is open already", id);
    if (!LOAD(device->state->present)) return fail(GC_ERR_IO, "%s is gone", id);
    GC_ERROR error = lock_device(device);
    if (error) return error;
    if ((error = start_camera(device))) {
        release_device(device);
        return error;
    }
    device->open = true;
    *out = device;
    return GC_ERR_SUCCESS;
}

API GC_ERROR DevClose(void *handle) {
    NEEDS(handle, DEVICE);
    close_device(handle);
    return GC_ERR_SUCCESS;
}

API GC_ERROR DevGetInfo(void *handle, int32_t command, int32_t *type, void *out, size_t *size) {
    NEEDS(handle, DEVICE);
    return device_info(handle, command, type, out, size);
}

API GC_ERROR DevGetPort(void *handle, void **port) {
    NEEDS(handle, DEVICE);
    *port = &((Device *)handle)->port;
    return GC_ERR_SUCCESS;
}

API GC_ERROR DevGetParentIF(void *handle, void **interface) {
    NEEDS(handle, DEVICE);
    *interface = &the_interface;
    return GC_ERR_SUCCESS;
}
