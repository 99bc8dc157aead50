/* The agent with stdin and stdout in place of a network: `agent_pipes runs/latest/join-3`.

   A frame is one letter, the size in 4 bytes, little endian, and so many bytes. In come `g` the answer to cfg, `h` say
   hello now, `n` and `r` a message on nav and rx; out go `c` and `t` a message for cmd and tx, `j` hold the token from
   now on, `e` the end with its reason. Whatever carries the frames is the transport: tests do, where zenoh-pico is not. */
#include <stdio.h>
#include <string.h>

#include "agent.h"
#include "join.h"
#include "msgpack.h"

#define MOST_BYTES 65535

static void give(char letter, const uint8_t *data, size_t size) {
    uint8_t head[5] = {(uint8_t)letter};
    to_bytes(head + 1, size, 4, false);
    fwrite(head, 1, sizeof head, stdout);
    fwrite(data, 1, size, stdout);
    fflush(stdout);
}

static void put(void *context, enum agent_key key, const uint8_t *data, size_t size) {
    (void)context;
    give(key == KEY_CMD ? 'c' : 't', data, size);
}

int main(int count, char **words) {
    static struct agent agent;
    static uint8_t data[MOST_BYTES];
    struct join join;
    if (count != 2 || !join_read(&join, words[1])) {
        fprintf(stderr, "usage: %s FOLDER, the join-<i> that a run wrote\n", words[0]);
        return 2;
    }
    uint8_t head[5];
    bool joined = false;
    while (fread(head, 1, sizeof head, stdin) == sizeof head) {
        size_t size = (size_t)from_bytes(head + 1, 4, false);
        if (size > MOST_BYTES || fread(data, 1, size, stdin) != size) {
            return 2;
        }
        if (head[0] == 'g') {
            if (!agent_configure(&agent, join.vehicle, data, size)) {
                fprintf(stderr, "%s\n", agent.why);
                return 2;
            }
            agent.put = put;
        } else if (!agent.put) {
            return 2;
        } else if (head[0] == 'h') {
            agent_hello(&agent);
        } else {
            agent_take(&agent, data, size);
        }
        if (agent.joined && !joined) {
            give('j', data, 0);
            joined = true;
        }
        if (agent.over) {
            give('e', (const uint8_t *)agent.why, strlen(agent.why));
            return 0;
        }
    }
    return 1;
}
