/* The shared files of $FRINGED_GENTL_DIR: finding cameras, locking one, and its clock. See memory.py for the layout. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#include "producer.h"

int64_t now_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000000000LL + now.tv_nsec;
}

static bool path_of(const Device *device, const char *ending, char *path, size_t room) {
    const char *directory = getenv("FRINGED_GENTL_DIR");
    return directory && (size_t)snprintf(path, room, "%s/cam%d.%s", directory, device->index, ending) < room;
}

static void *map(int fd, size_t bytes, int protection) {
    struct stat file;
    if (fstat(fd, &file) || (size_t)file.st_size < bytes) return NULL;
    void *memory = mmap(NULL, bytes, protection, MAP_SHARED, fd, 0);
    return memory == MAP_FAILED ? NULL : memory;
}

void unmap_state(Device *device) {
    if (device->state) munmap(device->state, sizeof(State));
    if (device->fd >= 0) close(device->fd);
    device->state = NULL;
    device->fd = -1;
}

static void find(Device *device) {
    char path[512];
    struct stat file;
    bool there = path_of(device, "state", path, sizeof path) && !stat(path, &file);
    if (device->state && there && file.st_ino == device->inode) return;
    unmap_state(device);
    if (!there || (device->fd = open(path, O_RDWR | O_CLOEXEC)) < 0) return;
    device->inode = file.st_ino;
    device->state = map(device->fd, sizeof(State), PROT_READ | PROT_WRITE);
    const State *state = device->state;
    bool good = state && LOAD(state->magic) == STATE_MAGIC && state->width <= MAX_SIDE && state->height <= MAX_SIDE;
    if (!good) unmap_state(device);
}

/* Updates the list of cameras; an open one is kept, present or not. */
void scan(Device *devices) {
    for (int i = 0; i < (int)MAX_CAMERAS; i++)
        if (!devices[i].open) find(&devices[i]);
}

/* A camera that was unplugged and plugged in again is another one: old handles stay invalid. */
bool is_present(const Device *device) {
    return LOAD(device->state->present) && LOAD(device->state->power_cycles) == device->power_cycle;
}

/* The lock belongs to the open file, so it ends with the process; it is not inherited by exec. */
static struct flock whole_file(short type) {
    struct flock lock;
    memset(&lock, 0, sizeof lock);
    lock.l_type = type;
    lock.l_whence = SEEK_SET;
    return lock;
}

bool is_locked_elsewhere(const Device *device) {
    struct flock lock = whole_file(F_WRLCK);
    return !fcntl(device->fd, F_OFD_GETLK, &lock) && lock.l_type != F_UNLCK;
}

static int bind_cable(Device *device) {
    struct stat file;
    struct sockaddr_un address;
    memset(&address, 0, sizeof address);
    address.sun_family = AF_UNIX;
    if (!path_of(device, "sock", address.sun_path, sizeof address.sun_path)) return -1;
    unlink(address.sun_path); /* left by a process that was killed: the lock is free */
    int cable = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (cable >= 0 && bind(cable, (struct sockaddr *)&address, sizeof address)) {
        close(cable);
        return -1;
    }
    device->socket_inode = cable >= 0 && !stat(address.sun_path, &file) ? file.st_ino : 0;
    return cable;
}

static Image *map_image(Device *device) {
    char path[512];
    if (!path_of(device, "img", path, sizeof path)) return NULL;
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) return NULL;
    Image *image = map(fd, sizeof(Image), PROT_READ);
    bool good = image && image->magic == IMAGE_MAGIC && image->slots == SLOTS && image->width == device->state->width &&
                image->height == device->state->height && image->slot_bytes >= SLOT_HEADER &&
                image->slot_bytes < ((uint64_t)1 << 32);
    device->image_bytes = good ? SLOT_HEADER + image->slots * image->slot_bytes : 0;
    if (image) munmap(image, sizeof(Image));
    image = good ? map(fd, device->image_bytes, PROT_READ) : NULL;
    close(fd);
    return image;
}

/* Locks the camera for this process and opens its light and trigger lines. */
GC_ERROR lock_device(Device *device) {
    struct flock lock = whole_file(F_WRLCK);
    if (fcntl(device->fd, F_OFD_SETLK, &lock))
        return errno == EAGAIN || errno == EACCES
                   ? fail(GC_ERR_RESOURCE_IN_USE, "%s is open in another process", device->id)
                   : fail(GC_ERR_IO, "%s: %s", device->id, strerror(errno));
    device->held = true;
    device->socket = bind_cable(device);
    device->image = map_image(device);
    if (device->socket < 0 || !device->image) {
        GC_ERROR error = fail(GC_ERR_IO, "%s: its %s in FRINGED_GENTL_DIR is not usable: %s", device->id,
                              device->socket < 0 ? "socket" : "image", strerror(errno));
        release_device(device);
        return error;
    }
    STORE(device->state->owner_pid, (uint64_t)getpid());
    return GC_ERR_SUCCESS;
}

/* Afterwards another process may lock the camera; its state must not be written any more. */
void unlock_device(Device *device) {
    struct flock lock = whole_file(F_UNLCK);
    if (!device->held) return;
    STORE(device->state->owner_pid, 0);
    device->held = false;
    fcntl(device->fd, F_OFD_SETLK, &lock);
}

void release_device(Device *device) {
    char path[512];
    struct stat file;
    if (device->socket >= 0) {
        close(device->socket);
        bool ours = path_of(device, "sock", path, sizeof path) && !stat(path, &file) && file.st_ino == device->socket_inode;
        if (ours) unlink(path); /* a new camera of the same number may have its own there */
    }
    if (device->image) munmap(device->image, device->image_bytes);
    device->socket = -1;
    device->image = NULL;
    unlock_device(device);
}

/* The camera's clock at a time of CLOCK_MONOTONIC, rounded down as in cable.py. */
int64_t device_clock_ns(const State *state, int64_t t_ns) {
    uint64_t before;
    int64_t base, offset, drift_ppb;
    do {
        before = LOAD(state->clock_sequence);
        base = LOAD(state->clock_base_ns);
        offset = LOAD(state->clock_offset_ns);
        drift_ppb = LOAD(state->clock_drift_ppb);
    } while (before & 1 || before != LOAD(state->clock_sequence));
    __int128 gained = (__int128)(t_ns - base) * drift_ppb;
    int64_t whole = (int64_t)(gained / 1000000000);
    if (gained % 1000000000 < 0) whole--;
    return offset + (t_ns - base) + whole;
}
