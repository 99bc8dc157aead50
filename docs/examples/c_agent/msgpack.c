#include "msgpack.h"

#include <string.h>

uint64_t from_bytes(const uint8_t *data, int size, bool big) {
    uint64_t value = 0;
    for (int k = 0; k < size; k++) {
        value = value << 8 | data[big ? k : size - 1 - k];
    }
    return value;
}

void to_bytes(uint8_t *data, uint64_t value, int size, bool big) {
    for (int k = 0; k < size; k++) {
        data[big ? size - 1 - k : k] = (uint8_t)(value >> 8 * k);
    }
}

double real_of(uint64_t bits) {
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

uint64_t bits_of(double value) {
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static bool fail(struct reader *from) {
    from->failed = true;
    return false;
}

static const uint8_t *take(struct reader *from, size_t size) {
    if (from->failed || from->left < size) {
        from->failed = true;
        return NULL;
    }
    const uint8_t *data = from->at;
    from->at += size;
    from->left -= size;
    return data;
}

/* The first byte of a value, which says what it is; 0xc1, which MessagePack never uses, when nothing is left. */
static uint8_t head(struct reader *from) {
    const uint8_t *byte = take(from, 1);
    return byte ? *byte : 0xc1;
}

static bool number(struct reader *from, int size, uint64_t *value) {
    const uint8_t *data = take(from, (size_t)size);
    if (data) {
        *value = from_bytes(data, size, true);
    }
    return data != NULL;
}

/* A size that follows in 1, 2 or 4 bytes, by how far the first byte is beyond the one for the smallest. */
static bool length(struct reader *from, uint8_t beyond, int smallest, uint32_t *size) {
    uint64_t value;
    if (!number(from, smallest << beyond, &value)) {
        return false;
    }
    *size = (uint32_t)value;
    return true;
}

bool read_array(struct reader *from, uint32_t *size) {
    uint8_t byte = head(from);
    if (byte >= 0x90 && byte <= 0x9f) {
        *size = byte & 0x0f;
        return true;
    }
    return byte == 0xdc || byte == 0xdd ? length(from, byte - 0xdc, 2, size) : fail(from);
}

bool read_map(struct reader *from, uint32_t *size) {
    uint8_t byte = head(from);
    if (byte >= 0x80 && byte <= 0x8f) {
        *size = byte & 0x0f;
        return true;
    }
    return byte == 0xde || byte == 0xdf ? length(from, byte - 0xde, 2, size) : fail(from);
}

bool read_uint(struct reader *from, uint64_t *value) {
    uint8_t byte = head(from);
    if (byte <= 0x7f) {
        *value = byte;
        return true;
    }
    return byte >= 0xcc && byte <= 0xcf ? number(from, 1 << (byte - 0xcc), value) : fail(from);
}

bool read_bool(struct reader *from, bool *value) {
    uint8_t byte = head(from);
    *value = byte == 0xc3;
    return byte == 0xc2 || byte == 0xc3 ? true : fail(from);
}

bool read_real(struct reader *from, double *value) {
    uint8_t byte = head(from);
    uint64_t bits;
    if (byte <= 0x7f) {
        *value = byte;
    } else if (byte >= 0xe0) {
        *value = (int8_t)byte;
    } else if (byte >= 0xcc && byte <= 0xcf && number(from, 1 << (byte - 0xcc), &bits)) {
        *value = (double)bits;
    } else if (byte >= 0xd0 && byte <= 0xd3 && number(from, 1 << (byte - 0xd0), &bits)) {
        int unused = 64 - (8 << (byte - 0xd0));
        *value = (double)((int64_t)(bits << unused) >> unused);
    } else if (byte == 0xcb && number(from, 8, &bits)) {
        *value = real_of(bits);
    } else {
        return fail(from);
    }
    return true;
}

bool read_reals(struct reader *from, double *values, uint32_t size) {
    uint32_t found;
    if (!read_array(from, &found) || found != size) {
        return fail(from);
    }
    for (uint32_t k = 0; k < size; k++) {
        if (!read_real(from, &values[k])) {
            return false;
        }
    }
    return true;
}

bool read_str(struct reader *from, const char **text, uint32_t *size) {
    uint8_t byte = head(from);
    if (byte >= 0xa0 && byte <= 0xbf) {
        *size = byte & 0x1f;
    } else if (byte < 0xd9 || byte > 0xdb || !length(from, byte - 0xd9, 1, size)) {
        return fail(from);
    }
    *text = (const char *)take(from, *size);
    return *text != NULL;
}

bool read_bin(struct reader *from, const uint8_t **data, uint32_t *size) {
    uint8_t byte = head(from);
    if (byte < 0xc4 || byte > 0xc6 || !length(from, byte - 0xc4, 1, size)) {
        return fail(from);
    }
    *data = take(from, *size);
    return *data != NULL;
}

bool skip(struct reader *from) {
    /* Counts values that are still to come instead of calling itself: no message can exhaust the stack. */
    for (uint64_t due = 1; due > 0; due--) {
        struct reader start = *from;
        uint8_t byte = head(from);
        uint32_t size = 0;
        const char *text;
        const uint8_t *data;
        double value;
        if (byte == 0xc0 || byte == 0xc2 || byte == 0xc3) {
            continue;
        }
        if (byte == 0xca) { /* a float of 4 bytes */
            take(from, 4);
            continue;
        }
        *from = start;
        if ((byte >= 0x90 && byte <= 0x9f) || byte == 0xdc || byte == 0xdd) {
            due += read_array(from, &size) ? size : 0;
        } else if ((byte >= 0x80 && byte <= 0x8f) || byte == 0xde || byte == 0xdf) {
            due += read_map(from, &size) ? 2 * (uint64_t)size : 0;
        } else if ((byte >= 0xa0 && byte <= 0xbf) || (byte >= 0xd9 && byte <= 0xdb)) {
            read_str(from, &text, &size);
        } else if (byte >= 0xc4 && byte <= 0xc6) {
            read_bin(from, &data, &size);
        } else {
            read_real(from, &value);
        }
        if (from->failed) {
            return false;
        }
    }
    return !from->failed;
}

static uint8_t *give(struct writer *to, size_t size) {
    if (to->failed || to->room - to->size < size) {
        to->failed = true;
        return NULL;
    }
    to->size += size;
    return to->data + to->size - size;
}

static void put(struct writer *to, uint8_t byte, uint64_t value, int size) {
    uint8_t *data = give(to, 1 + (size_t)size);
    if (data) {
        data[0] = byte;
        to_bytes(data + 1, value, size, true);
    }
}

static void copy(struct writer *to, const void *from, size_t size) {
    uint8_t *data = give(to, size);
    if (data) {
        memcpy(data, from, size);
    }
}

void write_array(struct writer *to, uint32_t size) { put(to, (uint8_t)(0x90 | size), 0, 0); }

void write_uint(struct writer *to, uint64_t value) {
    if (value <= 0x7f) {
        put(to, (uint8_t)value, 0, 0);
    } else if (value <= UINT8_MAX) {
        put(to, 0xcc, value, 1);
    } else if (value <= UINT16_MAX) {
        put(to, 0xcd, value, 2);
    } else if (value <= UINT32_MAX) {
        put(to, 0xce, value, 4);
    } else {
        put(to, 0xcf, value, 8);
    }
}

void write_bool(struct writer *to, bool value) { put(to, value ? 0xc3 : 0xc2, 0, 0); }

void write_real(struct writer *to, double value) { put(to, 0xcb, bits_of(value), 8); }

void write_str(struct writer *to, const char *text) {
    put(to, (uint8_t)(0xa0 | strlen(text)), 0, 0);
    copy(to, text, strlen(text));
}

void write_bin(struct writer *to, const uint8_t *data, size_t size) {
    put(to, 0xc4, size, 1);
    copy(to, data, size);
}
