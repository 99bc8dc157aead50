/* The channel to the controller: a stream of messages, each with its length, its kind and its bytes.

   All that a program does in one turn travels at once, with its end: the last message of a turn is 'I'. A message that
   needs an answer (`ask`) is sent at once. */
#include "preload.h"
#include <stdarg.h>
#include <stdio.h>

struct configuration config;
char home[4096], visible[16384];
i64 now;
static u8 out[1 << 16], in[2 * MOST_MESSAGE];
static size_t n_out, at_in, n_in;

static void put(const void *data, size_t size) {
  while (size) {
    if (n_out == sizeof out) flush();
    size_t part = size < sizeof out - n_out ? size : sizeof out - n_out;
    memcpy(out + n_out, data, part);
    n_out += part, data = (const u8 *)data + part, size -= part;
  }
}

void flush(void) {
  for (size_t sent = 0; sent < n_out;) {
    long n = SYS(SYS_sendto, CHANNEL, out + sent, n_out - sent, MSG_NOSIGNAL, 0, 0);
    if (n == -EINTR) continue;
    if (n <= 0) SYS(SYS_exit_group, 99); /* the controller has gone, and so does the program */
    sent += n;
  }
  n_out = 0;
}

void tell(u8 kind, const void *head, size_t head_size, const void *body, size_t size) {
  u32 length = 1 + head_size + size;
  put(&length, sizeof length);
  put(&kind, 1);
  put(head, head_size);
  put(body, size);
}

void tell_descriptor(u8 kind, const void *head, size_t size, int descriptor) {
  flush();
  u32 length = 1 + size;
  struct iovec parts[3] = {{&length, 4}, {&kind, 1}, {(void *)head, size}};
  union { struct cmsghdr header; char space[CMSG_SPACE(sizeof(int))]; } control = {
      .header = {.cmsg_len = CMSG_LEN(sizeof(int)), .cmsg_level = SOL_SOCKET, .cmsg_type = SCM_RIGHTS}};
  memcpy(CMSG_DATA(&control.header), &descriptor, sizeof descriptor);
  struct msghdr message = {.msg_iov = parts, .msg_iovlen = 3, .msg_control = &control, .msg_controllen = sizeof control};
  if (SYS(SYS_sendmsg, CHANNEL, &message, MSG_NOSIGNAL) <= 0) SYS(SYS_exit_group, 99);
}

struct message hear(void) {
  u32 length = 0;
  for (;;) {
    if (n_in - at_in >= 4) {
      memcpy(&length, in + at_in, 4);
      if (n_in - at_in >= 4 + (size_t)length) break;
    }
    if (at_in) memmove(in, in + at_in, n_in -= at_in), at_in = 0;
    long n = SYS(SYS_recvfrom, CHANNEL, in + n_in, sizeof in - n_in, 0, 0, 0);
    if (n == -EINTR) continue;
    if (n <= 0) SYS(SYS_exit_group, 99);
    n_in += n;
  }
  struct message message = {in[at_in + 4], in + at_in + 5, length - 1};
  at_in += 4 + length;
  return message;
}

struct message ask(u8 answer) {
  flush();
  struct message message = hear();
  if (message.kind != answer) SYS(SYS_exit_group, 98); /* nothing else comes in the middle of a turn */
  return message;
}

void say_hello(void) {
  tell('H', 0, 0, 0, 0);
  struct message message = ask('J');
  memcpy(&config, message.data, sizeof config);
  const char *rest = (char *)message.data + sizeof config, *end = (char *)message.data + message.size;
  size_t n = strnlen(rest, sizeof home - 1);
  memcpy(home, rest, n);
  rest += n + 1;
  if (rest < end) memcpy(visible, rest, (size_t)(end - rest) < sizeof visible - 2 ? (size_t)(end - rest) : sizeof visible - 2);
  now = config.now;
}

void forget_channel(void) { n_out = at_in = n_in = 0; }

static int line_of(char *to, size_t size, const char *format, va_list values) {
  int head = snprintf(to, size, "uuv-fleet: ");
  int n = head + vsnprintf(to + head, size - head - 1, format, values);
  if (n > (int)size - 2) n = size - 2;
  to[n++] = '\n';
  return n;
}

void say(const char *format, ...) {
  static char line[1024];
  va_list values;
  va_start(values, format);
  int n = line_of(line, sizeof line, format, values);
  va_end(values);
  SYS(SYS_write, 2, line, n);
}

void give_up(const char *format, ...) {
  static char line[1024];
  va_list values;
  va_start(values, format);
  int n = line_of(line, sizeof line, format, values);
  va_end(values);
  SYS(SYS_write, 2, line, n);
  tell('R', 0, 0, line + 11, n - 12);
  flush();
  SYS(SYS_exit_group, 97);
  __builtin_unreachable();
}
