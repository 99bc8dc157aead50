/* An agent that follows the wire protocol (docs/reference/protocol.md), without any transport: bytes in, bytes out.

   It does what docs/examples/foreign_agent.py does, to the last bit: it commands velocity in proportion to the consensus
   error, and force and moments to what is missing. It knows a line as reference, formations that stay, and the full
   payload. Nothing is allocated. */
#ifndef C_AGENT_AGENT_H
#define C_AGENT_AGENT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define PROTOCOL_VERSION 2
#define MOST_NEIGHBOURS 32
#define MOST_WAITING 1024 /* deliveries that are not due yet */

enum agent_key { KEY_CMD, KEY_TX };

struct state {
    double sent_s; /* simulated time at which it was sent; below 0: never */
    double position[3], velocity[3]; /* NED */
};

struct neighbour {
    uint64_t id;
    double weight, offset[3];
    struct state heard;
};

struct waiting {
    uint64_t due;
    struct neighbour *from;
    struct state state;
};

struct agent {
    /* called for each message; it returns before the data are used again */
    void (*put)(void *context, enum agent_key key, const uint8_t *data, size_t size);
    void *context;

    uint64_t vehicle, life, begin, tick_ns, round_ticks;
    bool real_time; /* nobody waits: answer at once */
    double start[3], velocity[3], reference_weight, offset[3], tau_max[3];
    struct neighbour neighbours[MOST_NEIGHBOURS];
    uint32_t neighbour_count;

    bool world_echoed, netem_echoed, joined, over;
    char why[160]; /* why it cannot join, or what it was told at the end */

    bool asked; /* nav waits for its inbox */
    uint64_t nav_tick, known;
    double eta[5], nu[5];
    struct waiting waiting[MOST_WAITING];
    uint32_t waiting_count;
    uint64_t dropped; /* messages that were malformed, or for which there was no room */
};

/* Take the answer to cfg/<vehicle>. False: `why` says why this agent cannot join. Set `put` and `context` afterwards. */
bool agent_configure(struct agent *agent, uint64_t vehicle, const uint8_t *answer, size_t size);

/* Say hello on both keys, every 20 to 200 ms until `joined`; then declare the liveliness token. */
void agent_hello(struct agent *agent);

/* Take a message that came on nav/<vehicle> or rx/<vehicle>. When `over`, close the session. */
void agent_take(struct agent *agent, const uint8_t *message, size_t size);

#endif
