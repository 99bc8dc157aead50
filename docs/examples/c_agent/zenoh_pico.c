/* The agent over zenoh-pico: `agent runs/latest/join-3`. It has no password: its certificate says which agent it is. */
#include <stdio.h>
#include <string.h>
#include <zenoh-pico.h>

#include "agent.h"
#include "join.h"

#if Z_FEATURE_LINK_TLS != 1 || Z_FEATURE_LIVELINESS != 1 || Z_FEATURE_MULTI_THREAD != 1
#error "build zenoh-pico with Z_FEATURE_LINK_TLS=1, Z_FEATURE_LIVELINESS=1 and Z_FEATURE_MULTI_THREAD=1"
#endif

static struct agent agent;
static z_owned_mutex_t mutex; /* the agent's: messages come on a thread of zenoh-pico */
static z_owned_publisher_t publishers[2];

static uint8_t slice[65535];
static size_t slice_size;
static volatile bool answered;

static void put(void *context, enum agent_key key, const uint8_t *data, size_t size) {
    (void)context;
    z_owned_bytes_t payload;
    z_bytes_copy_from_buf(&payload, data, size);
    z_publisher_put(z_loan(publishers[key]), z_move(payload), NULL);
}

static void came(z_loaned_sample_t *sample, void *context) {
    (void)context;
    z_owned_slice_t data;
    z_bytes_to_slice(z_sample_payload(sample), &data);
    z_mutex_lock(z_loan_mut(mutex));
    agent_take(&agent, z_slice_data(z_loan(data)), z_slice_len(z_loan(data)));
    z_mutex_unlock(z_loan_mut(mutex));
    z_drop(z_move(data));
}

/* A long answer comes in several replies, one after the other. */
static void replied(z_loaned_reply_t *reply, void *context) {
    (void)context;
    if (!z_reply_is_ok(reply)) {
        return;
    }
    z_owned_slice_t data;
    z_bytes_to_slice(z_sample_payload(z_reply_ok(reply)), &data);
    size_t size = z_slice_len(z_loan(data));
    if (size <= sizeof slice - slice_size) {
        memcpy(slice + slice_size, z_slice_data(z_loan(data)), size);
        slice_size += size;
    }
    z_drop(z_move(data));
}

static void all_replied(void *context) {
    (void)context;
    answered = true;
}

static bool connect(z_owned_session_t *session, const struct join *join) {
    z_owned_config_t config;
    z_config_default(&config);
    /* The endpoint before all others: users of zenoh-pico report that it is not found otherwise. */
    zp_config_insert(z_loan_mut(config), Z_CONFIG_CONNECT_KEY, join->endpoint);
    zp_config_insert(z_loan_mut(config), Z_CONFIG_MODE_KEY, Z_CONFIG_MODE_CLIENT);
    zp_config_insert(z_loan_mut(config), Z_CONFIG_TLS_ENABLE_MTLS_KEY, "true");
    zp_config_insert(z_loan_mut(config), Z_CONFIG_TLS_ROOT_CA_CERTIFICATE_KEY, join->ca);
    zp_config_insert(z_loan_mut(config), Z_CONFIG_TLS_CONNECT_CERTIFICATE_KEY, join->certificate);
    zp_config_insert(z_loan_mut(config), Z_CONFIG_TLS_CONNECT_PRIVATE_KEY_KEY, join->key);
    return z_open(session, z_move(config), NULL) >= 0;
}

static bool ask(const z_loaned_session_t *session, const char *key) {
    z_view_keyexpr_t cfg;
    z_owned_closure_reply_t closure;
    z_get_options_t options;
    z_view_keyexpr_from_str(&cfg, key);
    z_closure(&closure, replied, all_replied, NULL);
    z_get_options_default(&options);
    options.consolidation = z_query_consolidation_none();
    if (z_get(session, z_loan(cfg), "", z_move(closure), &options) < 0) {
        return false;
    }
    while (!answered) {
        z_sleep_ms(10);
    }
    return slice_size > 0;
}

static bool subscribe(const z_loaned_session_t *session, z_owned_subscriber_t *subscriber, const char *key) {
    z_view_keyexpr_t expression;
    z_owned_closure_sample_t closure;
    z_view_keyexpr_from_str(&expression, key);
    z_closure(&closure, came, NULL, NULL);
    return z_declare_subscriber(session, subscriber, z_loan(expression), z_move(closure), NULL) >= 0;
}

static bool publish(const z_loaned_session_t *session, enum agent_key which, const char *key) {
    z_view_keyexpr_t expression;
    z_publisher_options_t options;
    z_view_keyexpr_from_str(&expression, key);
    z_publisher_options_default(&options);
    options.congestion_control = Z_CONGESTION_CONTROL_BLOCK;
    options.is_express = true;
    return z_declare_publisher(session, &publishers[which], z_loan(expression), &options) >= 0;
}

/* What the agent says of itself, read while no message changes it. */
static bool now(const bool *what) {
    z_mutex_lock(z_loan_mut(mutex));
    bool value = *what;
    z_mutex_unlock(z_loan_mut(mutex));
    return value;
}

int main(int count, char **words) {
    struct join join;
    z_owned_session_t session;
    z_owned_subscriber_t nav, rx;
    z_owned_liveliness_token_t token;
    z_view_keyexpr_t alive;
    if (count != 2 || !join_read(&join, words[1])) {
        fprintf(stderr, "usage: %s FOLDER, the join-<i> that a run wrote\n", words[0]);
        return 2;
    }
    if (!connect(&session, &join)) {
        fprintf(stderr, "cannot join at %s: nobody listens there, or refuses this certificate\n", join.endpoint);
        return 2;
    }
    const z_loaned_session_t *open = z_loan(session);
    z_mutex_init(&mutex);
    if (!ask(open, join.cfg) || !agent_configure(&agent, join.vehicle, slice, slice_size)) {
        fprintf(stderr, "cannot join: %s\n", slice_size ? agent.why : "the console did not answer");
        z_drop(z_move(session));
        return 2;
    }
    agent.put = put;
    if (!publish(open, KEY_CMD, join.cmd) || !publish(open, KEY_TX, join.tx) || !subscribe(open, &nav, join.nav) ||
        !subscribe(open, &rx, join.rx)) {
        fprintf(stderr, "cannot declare its keys\n");
        z_drop(z_move(session));
        return 2;
    }
    while (!now(&agent.joined) && !now(&agent.over)) {
        z_mutex_lock(z_loan_mut(mutex));
        agent_hello(&agent);
        z_mutex_unlock(z_loan_mut(mutex));
        z_sleep_ms(100);
    }
    z_view_keyexpr_from_str(&alive, join.alive);
    z_liveliness_declare_token(open, &token, z_loan(alive), NULL);
    while (!now(&agent.over)) {
        z_sleep_ms(100);
        if (z_session_is_closed(open)) {
            fprintf(stderr, "the run is gone\n");
            return 3;
        }
    }
    printf("%s\n", agent.why);
    z_drop(z_move(token));
    z_drop(z_move(session));
    return 0;
}
