/* Effect of an edge on a line, or of a software trigger: start of the acquisition, a burst or an exposure, or none.
 * All functions run in the camera's thread with the device's lock held. */
#include <string.h>

#include "producer.h"

static bool is_on(const Device *device, int trigger) {
    return get32(device, R_TriggerMode + 4 * (uint32_t)trigger);
}

/* The trigger that the camera waits for, or TRIGGERS if it needs none. */
static int waits_for(const Device *device) {
    if (is_on(device, TRIGGER_ACQUISITION) && !device->started) return TRIGGER_ACQUISITION;
    if (is_on(device, TRIGGER_BURST) && device->burst_to_go == 0) return TRIGGER_BURST;
    return is_on(device, TRIGGER_FRAME) ? TRIGGER_FRAME : TRIGGERS;
}

static bool runs_free(const Device *device) {
    return LOAD(device->state->acquiring) && waits_for(device) == TRIGGERS;
}

void refresh_armed(Device *device) {
    int trigger = waits_for(device);
    bool line = trigger == TRIGGER_FRAME && get32(device, R_TriggerSource + 4 * TRIGGER_FRAME) != SOURCE_SOFTWARE;
    STORE(device->state->armed, LOAD(device->state->acquiring) && line && is_present(device));
}

/* Edges arrive nearly in order; one too many for the list is ignored. */
void add_edge(Device *device, Edge edge) {
    if (device->edges == MAX_EDGES) {
        COUNT(device->state->ignored);
        return;
    }
    int at = device->edges++;
    while (at > 0 && device->edge[at - 1].t_ns > edge.t_ns) {
        device->edge[at] = device->edge[at - 1];
        at--;
    }
    device->edge[at] = edge;
}

bool next_edge(Device *device, int64_t now, Edge *edge) {
    if (!device->edges || (LOAD(device->state->real_time) && device->edge[0].t_ns > now)) return false;
    *edge = device->edge[0];
    memmove(device->edge, device->edge + 1, (size_t)--device->edges * sizeof *edge);
    return true;
}

static bool is_output(const Device *device, const Edge *edge) {
    return edge->source != SOURCE_SOFTWARE && get32(device, R_LineMode + 4 * (uint32_t)(edge->source - SOURCE_LINE0));
}

/* Whether the edge, after the line's inverter, has the direction of the trigger's activation. */
static bool matches_activation(const Device *device, const Edge *edge, int trigger) {
    if (edge->source == SOURCE_SOFTWARE) return edge->trigger == trigger;
    uint32_t line = (uint32_t)(edge->source - SOURCE_LINE0);
    uint32_t activation = get32(device, R_TriggerActivation + 4 * (uint32_t)trigger);
    int direction = get32(device, R_LineInverter + 4 * line) ? !edge->direction : edge->direction;
    return activation == EDGE_ANY || (int)activation == direction;
}

typedef enum { NO_EFFECT, IGNORED, GRANTED, MISSED, EXPOSES } Result;

/* A pulse has two edges and counts once: by the edge that matches, or by the first if neither does. */
static Result result_of(const Device *device, const Edge *edge, int trigger) {
    bool first = edge->direction == EDGE_RISING;
    if (!LOAD(device->state->acquiring) || trigger == TRIGGERS || !is_present(device))
        return first ? IGNORED : NO_EFFECT;
    if (get32(device, R_TriggerSource + 4 * (uint32_t)trigger) != (uint32_t)edge->source || is_output(device, edge))
        return first ? IGNORED : NO_EFFECT;
    if (!matches_activation(device, edge, trigger)) return edge->source == SOURCE_SOFTWARE ? IGNORED : NO_EFFECT;
    if (trigger != TRIGGER_FRAME) return GRANTED;
    return edge->busy_check && edge->t_ns < device->busy_until_ns ? MISSED : EXPOSES;
}

void apply_edge(Device *device, const Edge *edge) {
    State *state = device->state;
    int trigger = waits_for(device);
    switch (result_of(device, edge, trigger)) {
        case NO_EFFECT: break;
        case IGNORED: COUNT(state->ignored); break;
        case MISSED: COUNT(state->missed); break;
        case GRANTED:
            COUNT(state->granted);
            if (trigger == TRIGGER_ACQUISITION) device->started = true;
            else device->burst_to_go = get32(device, R_AcquisitionBurstFrameCount);
            break;
        case EXPOSES: expose_on(device, edge);
    }
    if (edge->sequence) STORE(state->acknowledged, edge->sequence);
    refresh_armed(device);
}

/* Without a trigger to wait for the camera exposes as often as it can. */
void free_run(Device *device, int64_t now) {
    if (!runs_free(device)) {
        device->next_free_ns = 0;
        return;
    }
    if (!device->next_free_ns) device->next_free_ns = now > device->busy_until_ns ? now : device->busy_until_ns;
    if (now < device->next_free_ns) return;
    expose(device, now, (int64_t)LOAD(device->state->exposure_ns), 0);
    device->next_free_ns = device->busy_until_ns;
    refresh_armed(device);
}
