/* The part of MessagePack that the wire protocol uses: a reader that never reads beyond its bytes, and a writer. */
#ifndef C_AGENT_MSGPACK_H
#define C_AGENT_MSGPACK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* What is left to read. Every function returns false, and `failed` stays set, once something else came than expected. */
struct reader {
    const uint8_t *at;
    size_t left;
    bool failed;
};

bool read_array(struct reader *from, uint32_t *size);
bool read_map(struct reader *from, uint32_t *size);
bool read_uint(struct reader *from, uint64_t *value);
bool read_bool(struct reader *from, bool *value);
bool read_real(struct reader *from, double *value); /* an integer, too */
bool read_reals(struct reader *from, double *values, uint32_t size);
bool read_str(struct reader *from, const char **text, uint32_t *size); /* not ended by 0 */
bool read_bin(struct reader *from, const uint8_t **data, uint32_t *size);
bool skip(struct reader *from); /* any value, with everything in it */

/* Room to write into; `failed` once it was too small. */
struct writer {
    uint8_t *data;
    size_t size, room;
    bool failed;
};

void write_array(struct writer *to, uint32_t size); /* up to 15 */
void write_uint(struct writer *to, uint64_t value);
void write_bool(struct writer *to, bool value);
void write_real(struct writer *to, double value);
void write_str(struct writer *to, const char *text); /* up to 31 bytes */
void write_bin(struct writer *to, const uint8_t *data, size_t size); /* up to 255 */

/* Little or big endian, whatever this machine is. */
uint64_t from_bytes(const uint8_t *data, int size, bool big);
void to_bytes(uint8_t *data, uint64_t value, int size, bool big);
double real_of(uint64_t bits);
uint64_t bits_of(double value);

#endif
