/* Sockets that several processes of the agent have, after a fork. One of them, the writer, puts what arrives into the pair,
   from which any of them reads. The writer keeps a socket that its program has closed, until nobody has it.

   The controller knows who has which. When the writer ends, it names another one. */
#include "preload.h"

int any_shared;

void share_socks(u32 child) {
  static struct { u64 id, connection; } held[SOCKETS];
  size_t n = 0;
  for (struct sock *s = socks; s < socks + SOCKETS; s++)
    if (s->used && s->references) s->shared = any_shared = 1, held[n].id = s->id, held[n++].connection = s->connection;
  if (n) tell('b', &child, sizeof child, held, n * sizeof *held);
}

void borrow_socks(void) {
  for (struct sock *s = socks; s < socks + SOCKETS; s++) {
    if (!s->used) continue;
    s->borrowed = 1;
    s->waiting = 0, s->n_waiting = s->room = 0; /* it stays with the writer */
    if (s->references) continue;
    SYS(SYS_close, s->peer);
    if (s->listener) SYS(SYS_close, s->own_end);
    s->used = 0;
  }
}

void release_sock(struct sock *s) {
  if (s->shared) {
    struct { u64 id, connection; u8 unread; } __attribute__((packed)) head = {s->id, s->connection, s->resets};
    tell('k', &head, sizeof head, 0, 0);
    if (!s->borrowed) return;
  } else if (s->type == SOCK_STREAM) {
    stream_close(s);
    return;
  }
  leave_port(s);
  SYS(SYS_close, s->peer);
  s->used = 0;
}

void pour_shared(void) {
  if (!any_shared) return;
  for (struct sock *s = socks; s < socks + SOCKETS; s++)
    if (s->used && s->n_waiting && !s->borrowed) stream_received(s);
}

int is_about_shared(struct message m) {
  if (m.kind != 'w' && m.kind != 'f' && m.kind != 'h') return 0;
  u64 id;
  memcpy(&id, m.data, 8);
  struct sock *s = socks;
  while (s < socks + SOCKETS && (!s->used || s->id != id)) s++;
  if (s == socks + SOCKETS) return 1;
  if (m.kind == 'w') s->borrowed = 0; /* this process writes from now on */
  else if (m.kind == 'h') {           /* another process has taken this call */
    SYS(SYS_close, s->own_end);
    s->listener = 0, s->shared = any_shared = 1;
  } else if (!s->references) { /* nobody has it any more */
    s->connection = 0;
    stream_close(s);
  }
  return 1;
}
