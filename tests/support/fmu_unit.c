/* A vehicle as a unit of co-simulation, of FMI 2 or FMI 3 (-DFMI=2, -DFMI=3), with declarations of its own.
 * It surges, pitches and turns; its equations are those of `Reference` in fmu_units.py. It can also misbehave. */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { SURGE_FORCE, PITCH_MOMENT, YAW_MOMENT, CURRENT, WRENCH = CURRENT + 3, POSE = WRENCH + 6,
       VELOCITY = POSE + 6, START = VELOCITY + 6, MASS = START + 12, FAIL_AT, HANG_AT, CRASH_AT, END_AT, EFFORT, COUNT };

typedef struct { double v[COUNT], time, effort; } Unit;

static void clear(Unit *unit) {
    memset(unit, 0, sizeof *unit);
    unit->v[MASS] = 20.0;
    for (int k = FAIL_AT; k <= END_AT; k++) unit->v[k] = INFINITY;
}

static void begin(Unit *unit) { memcpy(&unit->v[POSE], &unit->v[START], 12 * sizeof(double)); }

static bool step(Unit *unit, double h) {
    double *v = unit->v, *p = &v[POSE], *nu = &v[VELOCITY];
    if (unit->time >= v[FAIL_AT] - 1e-9) return false;
    while (unit->time >= v[HANG_AT] - 1e-9) ;
    if (unit->time >= v[CRASH_AT] - 1e-9) abort();
    double sth = sin(p[4]), cth = cos(p[4]), sps = sin(p[5]), cps = cos(p[5]);
    double along = cth * cps * v[CURRENT] + cth * sps * v[CURRENT + 1] - sth * v[CURRENT + 2];
    nu[0] += h * (v[SURGE_FORCE] + v[WRENCH] - 10.0 * (nu[0] - along)) / v[MASS];
    nu[4] += h * (v[PITCH_MOMENT] + v[WRENCH + 4] - 5.0 * nu[4] - 3.0 * sth) / 4.0;
    nu[5] += h * (v[YAW_MOMENT] + v[WRENCH + 5] - 5.0 * nu[5]) / 4.0;
    p[0] += h * cth * cps * nu[0];
    p[1] += h * cth * sps * nu[0];
    p[2] -= h * sth * nu[0];
    p[4] += h * nu[4];
    p[5] += h * nu[5] / cth;
    unit->effort += h * fabs(v[SURGE_FORCE]);  /* inside only: what resuming must not lose */
    v[EFFORT] = unit->effort;
    unit->time += h;
    return true;
}

static int get(Unit *unit, const unsigned vr[], size_t n, double value[]) {
    for (size_t k = 0; k < n; k++) { if (vr[k] >= COUNT) return 3; value[k] = unit->v[vr[k]]; }
    return 0;
}

static int set(Unit *unit, const unsigned vr[], size_t n, const double value[]) {
    for (size_t k = 0; k < n; k++) { if (vr[k] >= COUNT) return 3; unit->v[vr[k]] = value[k]; }
    return 0;
}

static Unit *copy(const Unit *unit) {
    Unit *other = malloc(sizeof *other);
    if (other) *other = *unit;
    return other;
}

static Unit *made(const char *token) {
    if (strcmp(token, "{a-vehicle}") != 0) return NULL;
    Unit *unit = malloc(sizeof *unit);
    if (unit) clear(unit);
    printf("a unit prints\n");
    return unit;
}

#if FMI == 2
#define F(name) fmi2##name
typedef int Bool;
typedef void (*Logger)(void *, const char *, int, const char *, const char *, ...);
static Logger logger;
void *fmi2Instantiate(const char *name, int kind, const char *guid, const char *resources, const Logger *functions, Bool visible,
                      Bool logging) {
    (void)name; (void)resources; (void)visible; (void)logging;
    logger = functions[0];
    return kind == 1 ? made(guid) : NULL;
}
int fmi2SetupExperiment(void *c, Bool a, double b, double start, Bool d, double e) {
    (void)a; (void)b; (void)d; (void)e;
    ((Unit *)c)->time = start;
    return 0;
}
int fmi2EnterInitializationMode(void *c) { (void)c; return 0; }
int fmi2GetReal(void *c, const unsigned vr[], size_t n, double value[]) { return get(c, vr, n, value); }
int fmi2SetReal(void *c, const unsigned vr[], size_t n, const double value[]) { return set(c, vr, n, value); }
int fmi2DoStep(void *c, double time, double h, Bool d) {
    (void)time; (void)d;
    if (step(c, h)) return 0;
    logger(NULL, "unit", 3, "logStatusError", "the battery is empty");
    return 3;
}
int fmi2GetFMUstate(void *c, void **state) { *state = copy(c); return 0; }
int fmi2SetFMUstate(void *c, void *state) { *(Unit *)c = *(Unit *)state; return 0; }
int fmi2FreeFMUstate(void *c, void **state) { (void)c; free(*state); *state = NULL; return 0; }
int fmi2SerializedFMUstateSize(void *c, void *state, size_t *size) { (void)c; (void)state; *size = sizeof(Unit); return 0; }
int fmi2SerializeFMUstate(void *c, void *state, char bytes[], size_t size) { (void)c; memcpy(bytes, state, size); return 0; }
int fmi2DeSerializeFMUstate(void *c, const char bytes[], size_t size, void **state) {
    (void)c; (void)size;
    *state = copy((const Unit *)bytes);
    return 0;
}
#else
#define F(name) fmi3##name
typedef bool Bool;
void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, Bool visible, Bool logging, Bool events,
                                  Bool early, const unsigned vr[], size_t n, void *environment, void *log, void *update) {
    (void)name; (void)resources; (void)visible; (void)logging; (void)events; (void)early;
    (void)vr; (void)n; (void)environment; (void)log; (void)update;
    return made(token);
}
int fmi3EnterInitializationMode(void *c, Bool a, double b, double start, Bool d, double e) {
    (void)a; (void)b; (void)d; (void)e;
    ((Unit *)c)->time = start;
    return 0;
}
int fmi3GetFloat64(void *c, const unsigned vr[], size_t n, double value[], size_t m) { (void)m; return get(c, vr, n, value); }
int fmi3SetFloat64(void *c, const unsigned vr[], size_t n, const double value[], size_t m) { (void)m; return set(c, vr, n, value); }
int fmi3DoStep(void *c, double time, double h, Bool d, Bool *event, Bool *end, Bool *early, double *last) {
    (void)d;
    *event = *early = false;
    *last = time + h;
    *end = time >= ((Unit *)c)->v[END_AT] - 1e-9;
    return step(c, h) ? 0 : 3;
}
int fmi3GetFMUState(void *c, void **state) { *state = copy(c); return 0; }
int fmi3SetFMUState(void *c, void *state) { *(Unit *)c = *(Unit *)state; return 0; }
int fmi3FreeFMUState(void *c, void **state) { (void)c; free(*state); *state = NULL; return 0; }
int fmi3SerializedFMUStateSize(void *c, void *state, size_t *size) { (void)c; (void)state; *size = sizeof(Unit); return 0; }
int fmi3SerializeFMUState(void *c, void *state, char bytes[], size_t size) { (void)c; memcpy(bytes, state, size); return 0; }
int fmi3DeserializeFMUState(void *c, const char bytes[], size_t size, void **state) {
    (void)c; (void)size;
    *state = copy((const Unit *)bytes);
    return 0;
}
#endif

int F(ExitInitializationMode)(void *c) { begin(c); return 0; }
int F(Terminate)(void *c) { (void)c; return 0; }
int F(Reset)(void *c) { clear(c); return 0; }
void F(FreeInstance)(void *c) { free(c); }
