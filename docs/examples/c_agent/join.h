/* The folder join-<i> that a run writes for an agent with a certificate: join.conf beside ca.pem, certificate.pem and
   key.pem. */
#ifndef C_AGENT_JOIN_H
#define C_AGENT_JOIN_H

#include <stdbool.h>
#include <stdint.h>

struct join {
    uint64_t version, vehicle;
    char endpoint[256]; /* the first one */
    char cfg[128], nav[128], rx[128], cmd[128], tx[128], alive[128];
    char ca[512], certificate[512], key[512]; /* paths of the PEM files */
};

/* False: there is no such folder, or something is missing in its join.conf. */
bool join_read(struct join *join, const char *folder);

#endif
