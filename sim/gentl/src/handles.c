/* The objects that handles point to, and the check of handles. */
#include "producer.h"

Module the_system = { SYSTEM, false, false };
Module the_interface = { INTERFACE, false, false };
Device devices[MAX_CAMERAS];

/* Only static objects are compared, so a stale or foreign pointer is never dereferenced. */
bool is_kind(const void *handle, Kind kind) {
    if (!the_system.initialised || !handle) return false;
    if (kind == SYSTEM) return handle == &the_system && the_system.open;
    if (kind == INTERFACE) return handle == &the_interface && the_interface.open;
    for (int i = 0; i < (int)MAX_CAMERAS; i++) {
        if (kind == DEVICE && handle == &devices[i]) return devices[i].open;
        if (kind == PORT && handle == &devices[i].port) return devices[i].open;
        if (kind == STREAM && handle == &devices[i].stream) return devices[i].stream.open;
    }
    return false;
}
