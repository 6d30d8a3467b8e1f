/* The producer's own objects. One mutex per device guards its registers and acquisition, one per stream its queues;
 * whoever needs both takes the device's first. */
#ifndef PRODUCER_H
#define PRODUCER_H
#include <pthread.h>
#include <stdbool.h>
#include <sys/types.h>

#include "gentl.h"
#include "state.h"

#define VENDOR "Fringed"
#define VERSION "1.0"
#define TL_TYPE "Custom"
#define XML_ADDRESS 0x100000u
#define MEMORY_FRAMES 8  /* what the camera itself holds between exposure and cable */
#define MAX_BUFFERS 512
#define MAX_EDGES 128
#define CHUNKS 4
#define OLD_TICK_NS 8

/* What a handle points to begins with its kind. */
typedef enum { SYSTEM = 0x46470001, INTERFACE, DEVICE, PORT, STREAM, BUFFER } Kind;

enum { TRIGGER_ACQUISITION, TRIGGER_BURST, TRIGGER_FRAME, TRIGGERS };
enum { SOURCE_SOFTWARE, SOURCE_LINE0, SOURCE_LINE1, SOURCE_LINE2, LINES = 3 };
enum { AUTO_OFF, AUTO_ONCE, AUTO_CONTINUOUS };
enum { EXPOSURE_TIMED, EXPOSURE_TRIGGER_WIDTH };
enum { EDGE_RISING, EDGE_FALLING, EDGE_ANY };

typedef struct { double scale[3], black, gamma; } Response;  /* of the channels to light */

typedef struct {  /* an exposed image on its way to the host */
    uint8_t *bytes;
    size_t capacity, image_bytes, filled;
    int64_t exposure_ns;
    double mean[3];  /* of the light, 0 to 1 */
    uint32_t width, height, x, y, format;
    uint64_t frame_id, timestamp, session;
    int64_t due_ns;
    bool overtaken;  /* its light is gone: it is lost where a sensor would have caught it in time */
    int chunks;
    SINGLE_CHUNK_DATA chunk[CHUNKS];
} Frame;

typedef struct Buffer {
    Kind kind;
    uint8_t *bytes;
    size_t size;
    void *user;
    bool own, queued, waiting, incomplete, filled_once;
    Frame frame;  /* its `bytes` are not used */
} Buffer;

typedef struct { Buffer *item[MAX_BUFFERS]; int count; } Queue;

typedef struct Stream {
    Kind kind;
    struct Device *device;
    pthread_mutex_t lock;
    pthread_cond_t arrived;
    Queue announced, input, output;
    bool open, grabbing, event, killed;
    uint64_t delivered, underrun, started, fired;
    uint8_t registers[S_END];
} Stream;

typedef struct { int64_t t_ns, width_ns; int source, trigger, direction; uint64_t image, answer; bool judged; } Edge;

typedef struct Device {
    Kind kind;
    struct { Kind kind; } port;
    int index;
    char id[32];
    State *state;
    Image *image;
    size_t image_bytes;
    int fd;
    ino_t inode, socket_inode;
    bool listed;
    Stream stream;
    /* while open: */
    bool open, held;  /* held: the lock is ours, until the camera is closed or gone */
    uint64_t power_cycle;
    int socket, wake;
    pthread_t thread;
    pthread_mutex_t lock;
    bool running;
    Edge edge[MAX_EDGES];
    int edges;
    Frame memory[MEMORY_FRAMES];
    int first, inside;
    Response response;  /* that the tables are made for */
    uint16_t *table[3]; /* 16 bits in, 16 bits out, for each channel */
    uint64_t session, frame_id;
    int64_t busy_until_ns, next_free_ns;
    int64_t frames_to_go, burst_to_go;  /* -1: no end */
    bool started;  /* the AcquisitionStart trigger came */
} Device;

/* info.c */
GC_ERROR fail(GC_ERROR code, const char *format, ...) __attribute__((format(printf, 2, 3)));
GC_ERROR put(const void *value, size_t size, int32_t type, int32_t *out_type, void *out, size_t *out_size);
GC_ERROR put_text(const char *text, int32_t *type, void *out, size_t *size);
GC_ERROR put_bool(bool value, int32_t *type, void *out, size_t *size);
GC_ERROR put_i32(int32_t value, int32_t *type, void *out, size_t *size);
GC_ERROR put_u32(uint32_t value, int32_t *type, void *out, size_t *size);
GC_ERROR put_u64(uint64_t value, int32_t *type, void *out, size_t *size);
GC_ERROR put_size(size_t value, int32_t *type, void *out, size_t *size);
GC_ERROR put_pointer(void *value, int32_t *type, void *out, size_t *size);

/* world.c */
int64_t now_ns(void);
bool is_there(const Device *device);
int64_t device_clock_ns(const State *state, int64_t t_ns);
void scan(Device *devices);
void forget(Device *device);
GC_ERROR take(Device *device);
void let_go(Device *device);
void release(Device *device);
bool taken_elsewhere(const Device *device);

/* registers.c */
uint32_t get32(const Device *device, uint32_t address);
uint64_t get64(const Device *device, uint32_t address);
double get_double(const Device *device, uint32_t address);
void set32(Device *device, uint32_t address, uint32_t value);
void set_double(Device *device, uint32_t address, double value);
void set_exposure(Device *device, double exposure_us);
void power_on(Device *device);
void refresh(Device *device);
GC_ERROR write_register(Device *device, uint64_t address, const void *value, size_t size);

/* sensor.c */
size_t image_bytes(uint32_t format, uint32_t width, uint32_t height);
bool format_exists(uint32_t format, uint64_t filter);
bool take_image(Device *device, Frame *frame, const Response *response, uint64_t wanted);

/* response.c */
Response response_of(const Device *device, int64_t exposure_ns);
uint16_t *const *response_tables(Device *device, const Response *response);
void free_tables(Device *device);
void follow_light(Device *device, const double mean[3]);

/* acquisition.c */
GC_ERROR start_camera(Device *device);
void stop_camera(Device *device);
void begin_acquisition(Device *device);
void end_acquisition(Device *device);
void software_trigger(Device *device, int trigger);

/* trigger.c */
void add_edge(Device *device, Edge edge);
bool next_edge(Device *device, int64_t now, Edge *edge);
void judge(Device *device, const Edge *edge);
bool runs_free(const Device *device);
void refresh_armed(Device *device);

/* exposure.c */
void expose_on(Device *device, const Edge *edge);
void free_run(Device *device, int64_t now);

/* stream.c */
typedef enum { HANDED_OVER, HANDED_OVER_INCOMPLETE, NO_BUFFER, NOT_GRABBING } Outcome;
Outcome hand_over(Stream *stream, const Frame *frame, bool truncate);
void close_stream(Stream *stream);
void refresh_stream_registers(Stream *stream);

/* system.c */
bool is_kind(const void *handle, Kind kind);

#define COUNT(field) __atomic_add_fetch(&(field), 1, __ATOMIC_ACQ_REL)
#define LOAD(field) __atomic_load_n(&(field), __ATOMIC_ACQUIRE)
#define STORE(field, value) __atomic_store_n(&(field), value, __ATOMIC_RELEASE)
#endif
