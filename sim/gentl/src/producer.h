/* Objects of the producer. One mutex per device guards its registers and acquisition, one per stream its queues; the
 * device's is locked first. */
#ifndef PRODUCER_H
#define PRODUCER_H
#include <pthread.h>
#include <stdbool.h>
#include <sys/types.h>

#include "formats.h"
#include "gentl.h"
#include "state.h"

#define VENDOR "Fringed"
#define VERSION "1.0"
#define TL_TYPE "Custom"
#define XML_ADDRESS 0x100000u
#define MEMORY_FRAMES 8  /* that the camera stores between exposure and cable */
#define MAX_BUFFERS 512
#define MAX_EDGES 128
#define CHUNKS 4
#define OLD_TICK_NS 8

/* Every object that a handle points to begins with its kind. */
typedef enum { SYSTEM = 0x46470001, INTERFACE, DEVICE, PORT, STREAM, BUFFER } Kind;

typedef struct { Kind kind; bool initialised, open; } Module;  /* the library or its interface */

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
    bool overwritten;  /* its image was overwritten before it was read */
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

typedef struct {
    int64_t t_ns, width_ns;
    int source, trigger, direction;
    uint64_t image, sequence;
    bool busy_check;
} Edge;

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
    bool open, held;  /* held: this process has the lock, until the camera is closed or unplugged */
    uint64_t power_cycle;
    int socket, wake;
    pthread_t thread;
    pthread_mutex_t lock;
    bool running;
    Edge edge[MAX_EDGES];
    int edges;
    Frame memory[MEMORY_FRAMES];
    int first, inside;
    Response response;  /* that the tables are computed for */
    uint16_t *table[3]; /* 16 bits in, 16 bits out, for each channel */
    uint64_t session, frame_id;
    int64_t busy_until_ns, next_free_ns;
    int64_t frames_to_go, burst_to_go;  /* -1: no end */
    bool started;  /* the AcquisitionStart trigger was received */
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
bool is_present(const Device *device);
int64_t device_clock_ns(const State *state, int64_t t_ns);
void scan(Device *devices);
void unmap_state(Device *device);
GC_ERROR lock_device(Device *device);
void unlock_device(Device *device);
void release_device(Device *device);
bool is_locked_elsewhere(const Device *device);

/* register_values.c */
uint32_t get32(const Device *device, uint32_t address);
uint64_t get64(const Device *device, uint32_t address);
double get_double(const Device *device, uint32_t address);
void set32(Device *device, uint32_t address, uint32_t value);
void set64(Device *device, uint32_t address, uint64_t value);
void set_double(Device *device, uint32_t address, double value);
void set_text(Device *device, uint32_t address, const char *value);

/* register_defaults.c */
void update_derived(Device *device);
void set_exposure(Device *device, double exposure_us);
void power_on(Device *device);

/* registers.c */
void refresh(Device *device);
GC_ERROR write_register(Device *device, uint64_t address, const void *value, size_t size);

/* pixel_formats.c */
const Format *format_of(uint32_t number);
size_t image_bytes(uint32_t format, uint32_t width, uint32_t height);
bool format_exists(uint32_t number, uint64_t filter);

/* sensor.c */
bool take_image(Device *device, Frame *frame, const Response *response, uint64_t requested);

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
void apply_edge(Device *device, const Edge *edge);
void refresh_armed(Device *device);
void free_run(Device *device, int64_t now);

/* exposure.c */
void expose(Device *device, int64_t start_ns, int64_t exposure_ns, uint64_t image);
void expose_on(Device *device, const Edge *edge);

/* stream.c */
typedef enum { DELIVERED, DELIVERED_INCOMPLETE, NO_BUFFER, NOT_GRABBING } Outcome;
Outcome deliver(Stream *stream, const Frame *frame, bool truncate);
void close_stream(Stream *stream);
void refresh_stream_registers(Stream *stream);

/* handles.c */
extern Module the_system, the_interface;
extern Device devices[MAX_CAMERAS];
bool is_kind(const void *handle, Kind kind);

#define COUNT(field) __atomic_add_fetch(&(field), 1, __ATOMIC_ACQ_REL)
#define LOAD(field) __atomic_load_n(&(field), __ATOMIC_ACQUIRE)
#define STORE(field, value) __atomic_store_n(&(field), value, __ATOMIC_RELEASE)
#endif
