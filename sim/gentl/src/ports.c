/* Ports: the remote device's and the data stream's registers, and the descriptions of both. */
#include <stdio.h>
#include <string.h>

#include "descriptions.h"
#include "producer.h"

#define NEEDS_HANDLE(handle) \
    if (!handle) return fail(GC_ERR_INVALID_HANDLE, "%s: no handle", __func__)

typedef struct { const char *text, *file, *module, *name; size_t size; } Port;

static Device *device_of(void *handle) {
    return is_kind(handle, PORT) ? (Device *)((char *)handle - offsetof(Device, port)) : NULL;
}

static Port port_of(void *handle) {
    if (is_kind(handle, STREAM))
        return (Port){ stream_xml, "stream.xml", "TLDataStream", "StreamPort", sizeof stream_xml - 1 };
    const Device *device = device_of(handle);
    if (!device) return (Port){ NULL, NULL, "TLModule", "TLPort", 0 };
    if (device->state->variant)
        return (Port){ old_camera_xml, "old_camera.xml", "Device", "Device", sizeof old_camera_xml - 1 };
    return (Port){ camera_xml, "camera.xml", "Device", "Device", sizeof camera_xml - 1 };
}

static bool read_description(const Port *port, uint64_t address, void *out, size_t *size) {
    if (!port->text || address < XML_ADDRESS || address - XML_ADDRESS > port->size) return false;
    size_t left = port->size - (size_t)(address - XML_ADDRESS);
    if (*size > left) *size = left;
    memcpy(out, port->text + (address - XML_ADDRESS), *size);
    return true;
}

API GC_ERROR GCReadPort(void *handle, uint64_t address, void *out, size_t *size) {
    NEEDS_HANDLE(handle);
    Port port = port_of(handle);
    Device *device = device_of(handle);
    if (!port.text) return fail(GC_ERR_NOT_IMPLEMENTED, "this module has no registers");
    if (device && !is_present(device)) return fail(GC_ERR_IO, "%s is gone", device->id);
    if (read_description(&port, address, out, size)) return GC_ERR_SUCCESS;
    size_t end = device ? R_END : S_END;
    if (address > end || *size > end - address)
        return fail(GC_ERR_INVALID_ADDRESS, "%zu bytes at 0x%llx", *size, (unsigned long long)address);
    if (device) {
        pthread_mutex_lock(&device->lock);
        refresh(device);
        memcpy(out, device->state->registers + address, *size);
        pthread_mutex_unlock(&device->lock);
    } else {
        Stream *stream = handle;
        pthread_mutex_lock(&stream->lock);
        refresh_stream_registers(stream);
        memcpy(out, stream->registers + address, *size);
        pthread_mutex_unlock(&stream->lock);
    }
    return GC_ERR_SUCCESS;
}

API GC_ERROR GCWritePort(void *handle, uint64_t address, const void *in, size_t *size) {
    NEEDS_HANDLE(handle);
    GC_ERROR error = GC_ERR_SUCCESS;
    Device *device = device_of(handle);
    if (device) {
        if (!is_present(device)) return fail(GC_ERR_IO, "%s is gone", device->id);
        pthread_mutex_lock(&device->lock);
        error = write_register(device, address, in, *size);
        pthread_mutex_unlock(&device->lock);
    } else if (is_kind(handle, STREAM)) {
        Stream *stream = handle;
        if (address != S_StreamBufferHandlingMode || *size != 4)
            return fail(GC_ERR_INVALID_ADDRESS, "%zu bytes at 0x%llx", *size, (unsigned long long)address);
        pthread_mutex_lock(&stream->lock);
        if (stream->grabbing) error = fail(GC_ERR_ACCESS_DENIED, "the buffer handling is locked while acquiring");
        else memcpy(stream->registers + address, in, *size);
        pthread_mutex_unlock(&stream->lock);
    } else
        error = fail(GC_ERR_NOT_IMPLEMENTED, "this module has no registers");
    return error;
}

API GC_ERROR GCReadPortStacked(void *handle, PORT_REGISTER_STACK_ENTRY *entry, size_t *count) {
    NEEDS_HANDLE(handle);
    for (size_t i = 0; i < *count; i++) {
        GC_ERROR error = GCReadPort(handle, entry[i].Address, entry[i].pBuffer, &entry[i].Size);
        if (error) {
            *count = i;
            return error;
        }
    }
    return GC_ERR_SUCCESS;
}

API GC_ERROR GCWritePortStacked(void *handle, PORT_REGISTER_STACK_ENTRY *entry, size_t *count) {
    NEEDS_HANDLE(handle);
    for (size_t i = 0; i < *count; i++) {
        GC_ERROR error = GCWritePort(handle, entry[i].Address, entry[i].pBuffer, &entry[i].Size);
        if (error) {
            *count = i;
            return error;
        }
    }
    return GC_ERR_SUCCESS;
}

static void write_url(const Port *port, char *url, size_t room) {
    snprintf(url, room, "Local:///%s;%X;%zX", port->file, XML_ADDRESS, port->size);
}

API GC_ERROR GCGetNumPortURLs(void *handle, uint32_t *count) {
    NEEDS_HANDLE(handle);
    if (!port_of(handle).text) return fail(GC_ERR_NOT_AVAILABLE, "this module has no description");
    *count = 1;
    return GC_ERR_SUCCESS;
}

API GC_ERROR GCGetPortURL(void *handle, char *url, size_t *size) {
    NEEDS_HANDLE(handle);
    Port port = port_of(handle);
    char text[128];
    if (!port.text) return fail(GC_ERR_NOT_AVAILABLE, "this module has no description");
    write_url(&port, text, sizeof text);
    return put_text(text, NULL, url, size);
}

API GC_ERROR GCGetPortURLInfo(void *handle, uint32_t index, int32_t command, int32_t *type, void *out, size_t *size) {
    NEEDS_HANDLE(handle);
    Port port = port_of(handle);
    char text[128];
    if (!port.text) return fail(GC_ERR_NOT_AVAILABLE, "this module has no description");
    if (index) return fail(GC_ERR_INVALID_INDEX, "description %u: there is one", index);
    write_url(&port, text, sizeof text);
    switch (command) {
        case URL_INFO_URL: return put_text(text, type, out, size);
        case URL_INFO_SCHEMA_VER_MAJOR:
        case URL_INFO_SCHEMA_VER_MINOR:
        case URL_INFO_FILE_VER_MAJOR: return put_i32(1, type, out, size);
        case URL_INFO_FILE_VER_MINOR:
        case URL_INFO_FILE_VER_SUBMINOR:
        case URL_INFO_SCHEME: return put_i32(0, type, out, size);
        case URL_INFO_FILE_REGISTER_ADDRESS: return put_u64(XML_ADDRESS, type, out, size);
        case URL_INFO_FILE_SIZE: return put_u64(port.size, type, out, size);
        case URL_INFO_FILENAME: return put_text(port.file, type, out, size);
    }
    return fail(GC_ERR_NOT_AVAILABLE, "URL info %d", command);
}

API GC_ERROR GCGetPortInfo(void *handle, int32_t command, int32_t *type, void *out, size_t *size) {
    NEEDS_HANDLE(handle);
    Port port = port_of(handle);
    Device *device = device_of(handle);
    switch (command) {
        case PORT_INFO_ID: return put_text(device ? device->id : port.name, type, out, size);
        case PORT_INFO_VENDOR: return put_text(VENDOR, type, out, size);
        case PORT_INFO_MODEL: return put_text(device ? device->state->model : port.module, type, out, size);
        case PORT_INFO_TLTYPE: return put_text(TL_TYPE, type, out, size);
        case PORT_INFO_MODULE: return put_text(port.module, type, out, size);
        case PORT_INFO_LITTLE_ENDIAN:
        case PORT_INFO_ACCESS_READ:
        case PORT_INFO_ACCESS_WRITE: return put_bool(true, type, out, size);
        case PORT_INFO_BIG_ENDIAN:
        case PORT_INFO_ACCESS_NA:
        case PORT_INFO_ACCESS_NI: return put_bool(false, type, out, size);
        case PORT_INFO_VERSION: return put_text(VERSION, type, out, size);
        case PORT_INFO_PORTNAME: return put_text(port.name, type, out, size);
    }
    return fail(GC_ERR_NOT_AVAILABLE, "port info %d", command);
}
