#include "join.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void set(char *to, size_t room, const char *value) {
    if (*to == 0) { /* of several endpoints the first */
        snprintf(to, room, "%s", value);
    }
}

bool join_read(struct join *join, const char *folder) {
    char path[512], name[32], value[256];
    memset(join, 0, sizeof *join);
    snprintf(path, sizeof path, "%s/join.conf", folder);
    FILE *file = fopen(path, "r");
    if (!file) {
        return false;
    }
    while (fscanf(file, "%31s %255[^\n]", name, value) == 2) {
        struct {
            const char *name;
            char *to;
            size_t room;
        } texts[] = {
            {"endpoint", join->endpoint, sizeof join->endpoint},
            {"cfg", join->cfg, sizeof join->cfg},
            {"nav", join->nav, sizeof join->nav},
            {"rx", join->rx, sizeof join->rx},
            {"cmd", join->cmd, sizeof join->cmd},
            {"tx", join->tx, sizeof join->tx},
            {"alive", join->alive, sizeof join->alive},
        };
        for (size_t k = 0; k < sizeof texts / sizeof *texts; k++) {
            if (strcmp(name, texts[k].name) == 0) {
                set(texts[k].to, texts[k].room, value);
            }
        }
        if (strcmp(name, "version") == 0) {
            join->version = strtoull(value, NULL, 10);
        } else if (strcmp(name, "vehicle") == 0) {
            join->vehicle = strtoull(value, NULL, 10);
        }
    }
    fclose(file);
    snprintf(join->ca, sizeof join->ca, "%s/ca.pem", folder);
    snprintf(join->certificate, sizeof join->certificate, "%s/certificate.pem", folder);
    snprintf(join->key, sizeof join->key, "%s/key.pem", folder);
    return join->version && join->vehicle && *join->endpoint && *join->cfg && *join->nav && *join->rx && *join->cmd &&
           *join->tx && *join->alive;
}
