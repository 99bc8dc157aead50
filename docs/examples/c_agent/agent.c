#include "agent.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "msgpack.h"

#define PAYLOAD_BYTES 63 /* version, sender, tick, position, velocity; then a CRC-32 */
#define STATE_BYTES (PAYLOAD_BYTES - 4)
static const double FULL_TURN = 6.283185307179586;

static bool is(const char *text, uint32_t size, const char *name) {
    return size == strlen(name) && memcmp(text, name, size) == 0;
}

static double at_most(double top, double value) { return value < top ? value : top; }
static double clipped(double value, double top) {
    double most = at_most(top, value);
    return most > -top ? most : -top;
}

static uint32_t crc32(const uint8_t *data, size_t size) {
    uint32_t crc = UINT32_MAX;
    for (size_t k = 0; k < size; k++) {
        crc ^= data[k];
        for (int bit = 0; bit < 8; bit++) {
            crc = crc >> 1 ^ (crc & 1 ? UINT32_C(0xedb88320) : 0);
        }
    }
    return ~crc;
}

/* ------------------------------------------------------------------------------------------------- the slice */

static bool read_offset(struct reader *from, double offset[3]) {
    uint32_t size, length;
    const char *name;
    bool found = false;
    if (!read_map(from, &size)) {
        return false;
    }
    for (uint32_t k = 0; k < size && read_str(from, &name, &length); k++) {
        if (is(name, length, "start")) {
            found = read_reals(from, offset, 3);
        } else {
            skip(from);
        }
    }
    return found && !from->failed;
}

static bool read_line(struct reader *from, struct agent *agent) {
    uint32_t size, length;
    const char *name, *kind = "";
    uint32_t kind_length = 0;
    if (!read_map(from, &size)) {
        return false;
    }
    for (uint32_t k = 0; k < size && read_str(from, &name, &length); k++) {
        if (is(name, length, "kind")) {
            read_str(from, &kind, &kind_length);
        } else if (is(name, length, "start")) {
            read_reals(from, agent->start, 3);
        } else if (is(name, length, "velocity")) {
            read_reals(from, agent->velocity, 3);
        } else {
            skip(from);
        }
    }
    return !from->failed && is(kind, kind_length, "line");
}

static bool read_neighbours(struct reader *from, struct agent *agent) {
    uint32_t size, fields, length;
    const char *name;
    if (!read_array(from, &size) || size > MOST_NEIGHBOURS) {
        return false;
    }
    for (uint32_t n = 0; n < size; n++) {
        struct neighbour *other = &agent->neighbours[n];
        other->heard.sent_s = -1;
        if (!read_map(from, &fields)) {
            return false;
        }
        for (uint32_t k = 0; k < fields && read_str(from, &name, &length); k++) {
            if (is(name, length, "id")) {
                read_uint(from, &other->id);
            } else if (is(name, length, "weight")) {
                read_real(from, &other->weight);
            } else if (is(name, length, "offset")) {
                if (!read_offset(from, other->offset)) {
                    return false;
                }
            } else {
                skip(from);
            }
        }
    }
    agent->neighbour_count = size;
    return !from->failed;
}

static bool refuse(struct agent *agent, const char *why) {
    snprintf(agent->why, sizeof agent->why, "%s", why);
    return false;
}

static bool read_slice(struct reader *from, struct agent *agent) {
    uint32_t size, length;
    const char *name;
    if (!read_map(from, &size)) {
        return refuse(agent, "cfg: the slice is no map");
    }
    for (uint32_t k = 0; k < size && read_str(from, &name, &length); k++) {
        if (is(name, length, "tick_ns")) {
            read_uint(from, &agent->tick_ns);
        } else if (is(name, length, "round_ticks")) {
            read_uint(from, &agent->round_ticks);
        } else if (is(name, length, "reference_weight")) {
            read_real(from, &agent->reference_weight);
        } else if (is(name, length, "tau_max")) {
            read_reals(from, agent->tau_max, 3);
        } else if (is(name, length, "offset")) {
            read_offset(from, agent->offset);
        } else if (is(name, length, "reference")) {
            if (!read_line(from, agent)) {
                return refuse(agent, "cfg: this agent knows a line as reference, and nothing else");
            }
        } else if (is(name, length, "neighbours")) {
            if (!read_neighbours(from, agent)) {
                return refuse(agent, "cfg: neighbours are malformed, or more than this agent has room for");
            }
        } else {
            skip(from);
        }
    }
    if (from->failed || !agent->tick_ns || !agent->round_ticks) {
        return refuse(agent, "cfg: the slice is malformed");
    }
    return true;
}

bool agent_configure(struct agent *agent, uint64_t vehicle, const uint8_t *answer, size_t size) {
    struct reader from = {answer, size, false};
    uint32_t entries, length;
    const char *name, *text;
    uint64_t version = 0;
    bool told = false;
    memset(agent, 0, sizeof *agent);
    agent->vehicle = vehicle;
    if (!read_map(&from, &entries)) {
        return refuse(agent, "cfg: the answer is no map");
    }
    for (uint32_t k = 0; k < entries && read_str(&from, &name, &length); k++) {
        if (is(name, length, "agent")) {
            told = read_slice(&from, agent);
            if (!told) {
                return false;
            }
        } else if (is(name, length, "incarnation")) {
            read_uint(&from, &agent->life);
        } else if (is(name, length, "begin")) {
            read_uint(&from, &agent->begin);
        } else if (is(name, length, "version")) {
            read_uint(&from, &version);
        } else if (is(name, length, "clock") && read_str(&from, &text, &length)) {
            agent->real_time = is(text, length, "real");
        } else if (is(name, length, "error") && read_str(&from, &text, &length)) {
            snprintf(agent->why, sizeof agent->why, "%.*s", (int)length, text);
            return false;
        } else {
            skip(&from);
        }
    }
    if (from.failed || !told) {
        return refuse(agent, "cfg: the answer is malformed");
    }
    if (version != PROTOCOL_VERSION) {
        return refuse(agent, "cfg: the run speaks another version of the protocol");
    }
    agent->known = agent->begin;
    return true;
}

/* ------------------------------------------------------------------------------------------------- the law */

/* Surge force [N], pitch and yaw moment [N m]; and the own velocity over ground [m/s, NED]. */
static void law(const struct agent *agent, double t, double tau[3], double velocity[3]) {
    const double *eta = agent->eta;
    double theta = eta[3], psi = eta[4];
    double u = agent->nu[0], v = agent->nu[1], w = agent->nu[2], q = agent->nu[3], r = agent->nu[4];
    double ct = cos(theta), st = sin(theta), cp = cos(psi), sp = sin(psi);
    velocity[0] = cp * ct * u - sp * v + cp * st * w;
    velocity[1] = sp * ct * u + cp * v + sp * st * w;
    velocity[2] = ct * w - st * u;
    double want[3];
    for (int k = 0; k < 3; k++) {
        /* In the order in which foreign_agent.py adds: another order would round otherwise. */
        double e = agent->reference_weight * (eta[k] - agent->start[k] - agent->velocity[k] * t - agent->offset[k]);
        for (uint32_t n = 0; n < agent->neighbour_count; n++) {
            const struct neighbour *other = &agent->neighbours[n];
            const struct state *heard = &other->heard;
            if (heard->sent_s >= 0) {
                double moved = heard->velocity[k] * (t - heard->sent_s);
                e += other->weight * (eta[k] - heard->position[k] - moved - other->offset[k]);
            }
        }
        want[k] = agent->velocity[k] - clipped(0.3 * e, 0.5);
    }
    double level = hypot(want[0], want[1]);
    double turn = remainder(atan2(want[1], want[0]) - psi, FULL_TURN);
    tau[0] = clipped(40 * (level * cos(turn) - u), agent->tau_max[0]);
    tau[1] = clipped(15 * (atan2(-want[2], level) - theta) - 10 * q, agent->tau_max[1]);
    tau[2] = clipped(15 * turn - 10 * r, agent->tau_max[2]);
}

/* ------------------------------------------------------------------------------------------------- messages */

static bool newer(const struct state *a, const struct state *b) {
    double of_a[7] = {a->sent_s}, of_b[7] = {b->sent_s};
    memcpy(of_a + 1, a->position, sizeof a->position);
    memcpy(of_a + 4, a->velocity, sizeof a->velocity);
    memcpy(of_b + 1, b->position, sizeof b->position);
    memcpy(of_b + 4, b->velocity, sizeof b->velocity);
    for (int k = 0; k < 7; k++) {
        if (of_a[k] != of_b[k]) {
            return of_a[k] > of_b[k];
        }
    }
    return false;
}

/* Whether a payload came as it was sent; if so, what it says. */
static bool read_payload(const struct agent *agent, const uint8_t *data, uint32_t size, struct state *state) {
    if (size != PAYLOAD_BYTES || crc32(data, STATE_BYTES) != from_bytes(data + STATE_BYTES, 4, false)) {
        return false;
    }
    state->sent_s = (double)from_bytes(data + 3, 8, false) * ((double)agent->tick_ns / 1e9);
    for (int k = 0; k < 3; k++) {
        state->position[k] = real_of(from_bytes(data + 11 + 8 * k, 8, false));
        state->velocity[k] = real_of(from_bytes(data + 35 + 8 * k, 8, false));
    }
    return true;
}

static void send(const struct agent *agent, enum agent_key key, const struct writer *message) {
    if (!message->failed) {
        agent->put(agent->context, key, message->data, message->size);
    }
}

static void say_hello(const struct agent *agent, enum agent_key key, bool echo) {
    uint8_t room[64];
    struct writer to = {room, 0, sizeof room, false};
    write_array(&to, 6);
    write_str(&to, "hello");
    write_str(&to, "agent");
    write_uint(&to, agent->vehicle);
    write_uint(&to, agent->life);
    write_uint(&to, PROTOCOL_VERSION);
    write_bool(&to, echo);
    send(agent, key, &to);
}

void agent_hello(struct agent *agent) {
    say_hello(agent, KEY_CMD, false);
    say_hello(agent, KEY_TX, false);
}

static void transmit(const struct agent *agent, const double velocity[3]) {
    uint8_t payload[PAYLOAD_BYTES], room[128];
    struct writer to = {room, 0, sizeof room, false};
    payload[0] = 1;
    to_bytes(payload + 1, agent->vehicle, 2, false);
    to_bytes(payload + 3, agent->nav_tick, 8, false);
    for (int k = 0; k < 3; k++) {
        to_bytes(payload + 11 + 8 * k, bits_of(agent->eta[k]), 8, false);
        to_bytes(payload + 35 + 8 * k, bits_of(velocity[k]), 8, false);
    }
    to_bytes(payload + STATE_BYTES, crc32(payload, STATE_BYTES), 4, false);
    write_array(&to, 4);
    write_str(&to, "tx");
    write_uint(&to, agent->life);
    write_uint(&to, agent->nav_tick);
    write_array(&to, 1);
    write_bin(&to, payload, sizeof payload);
    send(agent, KEY_TX, &to);
}

/* Answer the nav that waits, if everything that is due by then is here. */
static void answer(struct agent *agent) {
    if (!agent->asked || (agent->nav_tick > agent->known && !agent->real_time)) {
        return;
    }
    uint32_t kept = 0;
    for (uint32_t k = 0; k < agent->waiting_count; k++) {
        struct waiting *one = &agent->waiting[k];
        if (one->due > agent->nav_tick) {
            agent->waiting[kept++] = *one;
        } else if (newer(&one->state, &one->from->heard)) {
            one->from->heard = one->state;
        }
    }
    agent->waiting_count = kept;
    double tau[3], velocity[3];
    law(agent, (double)agent->nav_tick * ((double)agent->tick_ns / 1e9), tau, velocity);
    if (agent->nav_tick % agent->round_ticks == 0) {
        transmit(agent, velocity);
    }
    uint8_t room[64];
    struct writer to = {room, 0, sizeof room, false};
    write_array(&to, 5);
    write_str(&to, "cmd");
    write_uint(&to, agent->life);
    write_uint(&to, agent->nav_tick);
    write_array(&to, 3);
    for (int k = 0; k < 3; k++) {
        write_real(&to, tau[k]);
    }
    write_array(&to, 0); /* no telemetry */
    send(agent, KEY_CMD, &to);
    agent->asked = false;
}

static bool take_hello(struct agent *agent, struct reader *from) {
    const char *role;
    uint32_t length;
    if (!read_str(from, &role, &length)) {
        return false;
    }
    agent->world_echoed |= is(role, length, "world");
    agent->netem_echoed |= is(role, length, "netem");
    if (agent->world_echoed && agent->netem_echoed && !agent->joined) {
        agent->joined = true;
        say_hello(agent, KEY_CMD, true);
    }
    return true;
}

/* After five fields come roll, what its clock shows, and how sure the vehicle is: the law here needs none of them. */
static bool take_nav(struct agent *agent, struct reader *from, uint32_t fields, uint64_t tick) {
    double eta[5], nu[5];
    if (!read_reals(from, eta, 5) || !read_reals(from, nu, 5)) {
        return false;
    }
    while (fields-- > 5) {
        if (!skip(from)) {
            return false;
        }
    }
    if (from->left) {
        return false;
    }
    memcpy(agent->eta, eta, sizeof eta);
    memcpy(agent->nu, nu, sizeof nu);
    agent->nav_tick = tick;
    agent->asked = true;
    return true;
}

/* After six fields come a measured range, its standard deviation, and when it was measured: not needed here either. */
static bool take_delivery(struct agent *agent, struct reader *from) {
    uint32_t fields, size;
    uint64_t due, source;
    const uint8_t *data;
    struct state state;
    if (!read_array(from, &fields) || fields < 6 || fields > 9 || !read_uint(from, &due) || !skip(from) ||
        !read_uint(from, &source) || !skip(from) || !skip(from) || !read_bin(from, &data, &size)) {
        return false;
    }
    while (fields-- > 6) {
        if (!skip(from)) {
            return false;
        }
    }
    for (uint32_t n = 0; n < agent->neighbour_count; n++) {
        struct neighbour *other = &agent->neighbours[n];
        if (other->id != source || !read_payload(agent, data, size, &state)) {
            continue;
        }
        if (agent->waiting_count < MOST_WAITING) {
            agent->waiting[agent->waiting_count++] = (struct waiting){due, other, state};
        } else {
            agent->dropped++;
        }
    }
    return true;
}

static bool take_inbox(struct agent *agent, struct reader *from, uint64_t until) {
    uint32_t size, before = agent->waiting_count;
    bool more;
    if (!read_bool(from, &more) || !read_array(from, &size)) {
        return false;
    }
    for (uint32_t k = 0; k < size; k++) {
        if (!take_delivery(agent, from)) {
            agent->waiting_count = before;
            return false;
        }
    }
    if (from->left) {
        agent->waiting_count = before;
        return false;
    }
    agent->known = more ? agent->known : until;
    return true;
}

static bool take(struct agent *agent, struct reader *from) {
    uint32_t fields, length;
    const char *kind, *text;
    uint64_t life, tick;
    if (!read_array(from, &fields) || !read_str(from, &kind, &length)) {
        return false;
    }
    if (is(kind, length, "hello")) {
        return fields == 6 && take_hello(agent, from);
    }
    if (!read_uint(from, &life) || !read_uint(from, &tick)) {
        return false;
    }
    if (life != agent->life) {
        return true; /* for a life that is over */
    }
    if (is(kind, length, "nav") && fields >= 5 && fields <= 8) {
        return take_nav(agent, from, fields, tick);
    }
    if (is(kind, length, "rx") && fields == 5) {
        return take_inbox(agent, from, tick);
    }
    if (is(kind, length, "end") && fields == 4 && read_str(from, &text, &length)) {
        agent->over = true;
        snprintf(agent->why, sizeof agent->why, "%.*s", (int)length, text);
        return true;
    }
    return false;
}

void agent_take(struct agent *agent, const uint8_t *message, size_t size) {
    struct reader from = {message, size, false};
    if (!take(agent, &from)) {
        agent->dropped++;
    }
    if (agent->joined && !agent->over) {
        answer(agent);
    }
}
