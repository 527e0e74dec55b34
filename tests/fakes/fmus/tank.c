/* A tank as an FMU, of FMI 2 and 3, for co-simulation and model exchange: level' = inflow - leak sqrt(level).

   Only the functions that a simulation calls. It terminates at `limit`, and fails above 10 m. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { LEVEL0, INFLOW, LEAK, LIMIT, LEVEL, RATE, ROOM, REALS };
enum { STAGES = 100, SEED };
enum { OPEN = 200 };
enum { OK, WARNING, DISCARD, FAILED };

typedef struct {
  double reals[REALS], time;
  int stages, seed, open, ended, version;
  void *logger, *environment, *log3;
} Tank;

static void update(Tank *t) {
  t->reals[RATE] = t->reals[INFLOW] - (t->open ? 1 : 0) * t->stages * t->reals[LEAK] * sqrt(fmax(t->reals[LEVEL], 0));
  t->reals[ROOM] = t->reals[LIMIT] - t->reals[LEVEL];
}

static Tank *made(void) {
  Tank *t = calloc(1, sizeof(Tank));
  t->reals[LEVEL0] = 1, t->reals[INFLOW] = 0.1, t->reals[LEAK] = 0.2, t->reals[LIMIT] = 99;
  t->stages = 1, t->open = 1;
  return t;
}

static void begun(Tank *t) { t->reals[LEVEL] = t->reals[LEVEL0] + t->seed % 7, update(t); }

/* Steps of Euler of at most 0.01 s. Returns the time that is reached. */
static double stepped(Tank *t, double from, double step) {
  int count = (int)ceil(step / 0.01 - 1e-9);
  for (int k = 0; k < count; k++) {
    if (t->reals[LEVEL] > t->reals[LIMIT]) return t->ended = 1, from + k * step / count;
    update(t);
    t->reals[LEVEL] += step / count * t->reals[RATE];
  }
  return update(t), from + step;
}

static int get(Tank *t, const unsigned *vr, size_t n, double *values) {
  for (size_t k = 0; k < n; k++) values[k] = t->reals[vr[k]];
  return OK;
}
static int set(Tank *t, const unsigned *vr, size_t n, const double *values) {
  for (size_t k = 0; k < n; k++) t->reals[vr[k]] = values[k];
  return OK;
}
static int get_whole(Tank *t, const unsigned *vr, size_t n, int *values) {
  for (size_t k = 0; k < n; k++) values[k] = vr[k] == STAGES ? t->stages : vr[k] == SEED ? t->seed : t->open;
  return OK;
}
static int set_whole(Tank *t, const unsigned *vr, size_t n, const int *values) {
  for (size_t k = 0; k < n; k++) *(vr[k] == STAGES ? &t->stages : vr[k] == SEED ? &t->seed : &t->open) = values[k];
  return OK;
}

/* Both versions, where they do not differ. */
#define BOTH(result, name, arguments) \
  static result name##_ arguments; \
  result fmi2##name arguments __attribute__((alias(#name "_"))); \
  result fmi3##name arguments __attribute__((alias(#name "_"))); \
  static result name##_ arguments
BOTH(void, FreeInstance, (Tank *t)) { free(t); }
BOTH(int, ExitInitializationMode, (Tank *t)) { return begun(t), OK; }
BOTH(int, Terminate, (Tank *t)) { return OK; }
BOTH(int, EnterEventMode, (Tank *t)) { return OK; }
BOTH(int, EnterContinuousTimeMode, (Tank *t)) { return OK; }
BOTH(int, SetTime, (Tank *t, double time)) { return t->time = time, OK; }
BOTH(int, SetContinuousStates, (Tank *t, const double *x, size_t n)) { return t->reals[LEVEL] = x[0], update(t), OK; }
BOTH(int, GetContinuousStates, (Tank *t, double *x, size_t n)) { return x[0] = t->reals[LEVEL], OK; }
BOTH(int, GetNominalsOfContinuousStates, (Tank *t, double *x, size_t n)) { return x[0] = 1, OK; }
BOTH(int, GetEventIndicators, (Tank *t, double *z, size_t n)) { return z[0] = t->reals[LIMIT] - t->reals[LEVEL], OK; }
static int derivatives(Tank *t, double *dx) { return update(t), dx[0] = t->reals[RATE], OK; }
int fmi2GetDerivatives(Tank *t, double *dx, size_t n) { return derivatives(t, dx); }
int fmi3GetContinuousStateDerivatives(Tank *t, double *dx, size_t n) { return derivatives(t, dx); }

/* FMI 2 */
typedef struct {
  void (*logger)(void *, const char *, int, const char *, const char *, ...);
  void *allocate, *release, *finished, *environment;
} Callbacks;
typedef struct { int needed, terminate, nominals, values, defined; double next; } Event;
static Callbacks callbacks;
void *fmi2Instantiate(const char *name, int type, const char *guid, const char *place, const Callbacks *c, int v, int l) {
  callbacks = *c;
  return made();
}
int fmi2SetupExperiment(Tank *t, int d, double tolerance, double start, int e, double stop) { return OK; }
int fmi2EnterInitializationMode(Tank *t) { return OK; }
int fmi2GetReal(Tank *t, const unsigned *vr, size_t n, double *v) { return get(t, vr, n, v); }
int fmi2SetReal(Tank *t, const unsigned *vr, size_t n, const double *v) { return set(t, vr, n, v); }
int fmi2GetInteger(Tank *t, const unsigned *vr, size_t n, int *v) { return get_whole(t, vr, n, v); }
int fmi2SetInteger(Tank *t, const unsigned *vr, size_t n, const int *v) { return set_whole(t, vr, n, v); }
int fmi2GetBoolean(Tank *t, const unsigned *vr, size_t n, int *v) { return get_whole(t, vr, n, v); }
int fmi2SetBoolean(Tank *t, const unsigned *vr, size_t n, const int *v) { return set_whole(t, vr, n, v); }
int fmi2NewDiscreteStates(Tank *t, Event *e) {
  memset(e, 0, sizeof *e);
  return e->terminate = t->reals[LEVEL] >= t->reals[LIMIT], OK;
}
int fmi2CompletedIntegratorStep(Tank *t, int s, int *event, int *terminate) { return *event = *terminate = 0, OK; }
int fmi2DoStep(Tank *t, double now, double step, int no_set) {
  t->time = stepped(t, now, step);
  if (t->reals[LEVEL] > 10) {
    callbacks.logger(callbacks.environment, "tank", FAILED, "logStatusError", "the tank of 10 m is full");
    return FAILED;
  }
  return t->ended ? DISCARD : OK;
}
int fmi2GetBooleanStatus(Tank *t, int kind, int *value) { return *value = t->ended, OK; }
int fmi2GetRealStatus(Tank *t, int kind, double *value) { return *value = t->time, OK; }

/* FMI 3 */
typedef void (*Log)(void *, int, const char *, const char *);
static Log log3;
void *fmi3InstantiateModelExchange(const char *n, const char *i, const char *r, char v, char l, void *e, Log log) {
  return log3 = log, made();
}
void *fmi3InstantiateCoSimulation(const char *n, const char *i, const char *r, char v, char l, char m, char a,
                                  const unsigned *q, size_t nq, void *e, Log log, void *u) {
  return log3 = log, made();
}
int fmi3EnterInitializationMode(Tank *t, char d, double tolerance, double start, char e, double stop) { return OK; }
int fmi3GetFloat64(Tank *t, const unsigned *vr, size_t n, double *v, size_t nv) { return get(t, vr, n, v); }
int fmi3SetFloat64(Tank *t, const unsigned *vr, size_t n, const double *v, size_t nv) { return set(t, vr, n, v); }
int fmi3GetInt32(Tank *t, const unsigned *vr, size_t n, int *v, size_t nv) { return get_whole(t, vr, n, v); }
int fmi3SetInt32(Tank *t, const unsigned *vr, size_t n, const int *v, size_t nv) { return set_whole(t, vr, n, v); }
int fmi3GetBoolean(Tank *t, const unsigned *vr, size_t n, char *v, size_t nv) { return v[0] = (char)t->open, OK; }
int fmi3SetBoolean(Tank *t, const unsigned *vr, size_t n, const char *v, size_t nv) { return t->open = v[0], OK; }
int fmi3UpdateDiscreteStates(Tank *t, char *needed, char *terminate, char *nominals, char *values, char *defined,
                             double *next) {
  *needed = *nominals = *values = *defined = 0;
  return *terminate = t->reals[LEVEL] >= t->reals[LIMIT], OK;
}
int fmi3CompletedIntegratorStep(Tank *t, char s, char *event, char *terminate) { return *event = *terminate = 0, OK; }
int fmi3DoStep(Tank *t, double now, double step, char no_set, char *event, char *terminate, char *early, double *last) {
  *last = stepped(t, now, step), *terminate = (char)t->ended, *event = *early = 0;
  if (t->reals[LEVEL] > 10) return log3(0, FAILED, "logStatusError", "the tank of 10 m is full"), FAILED;
  return OK;
}

/* Functions that the standard requires and no simulation here calls. */
#define UNUSED(name) int fmi2##name(void) { return FAILED; }
UNUSED(CancelStep) UNUSED(DeSerializeFMUstate) UNUSED(FreeFMUstate) UNUSED(GetDirectionalDerivative)
UNUSED(GetFMUstate) UNUSED(GetIntegerStatus) UNUSED(GetRealOutputDerivatives) UNUSED(GetStatus) UNUSED(GetString)
UNUSED(GetStringStatus) UNUSED(GetTypesPlatform) UNUSED(GetVersion) UNUSED(Reset) UNUSED(SerializeFMUstate)
UNUSED(SerializedFMUstateSize) UNUSED(SetDebugLogging) UNUSED(SetFMUstate) UNUSED(SetRealInputDerivatives)
UNUSED(SetString)
#undef UNUSED
#define UNUSED(name) int fmi3##name(void) { return FAILED; }
UNUSED(ActivateModelPartition) UNUSED(DeserializeFMUState) UNUSED(EnterConfigurationMode) UNUSED(EnterStepMode)
UNUSED(EvaluateDiscreteStates) UNUSED(ExitConfigurationMode) UNUSED(FreeFMUState) UNUSED(GetAdjointDerivative)
UNUSED(GetBinary) UNUSED(GetClock) UNUSED(GetDirectionalDerivative) UNUSED(GetFMUState) UNUSED(GetFloat32)
UNUSED(GetInt16) UNUSED(GetInt64) UNUSED(GetInt8) UNUSED(GetIntervalDecimal) UNUSED(GetIntervalFraction)
UNUSED(GetNumberOfContinuousStates) UNUSED(GetNumberOfEventIndicators) UNUSED(GetNumberOfVariableDependencies)
UNUSED(GetOutputDerivatives) UNUSED(GetShiftDecimal) UNUSED(GetShiftFraction) UNUSED(GetString) UNUSED(GetUInt16)
UNUSED(GetUInt32) UNUSED(GetUInt64) UNUSED(GetUInt8) UNUSED(GetVariableDependencies) UNUSED(GetVersion)
UNUSED(InstantiateScheduledExecution) UNUSED(Reset) UNUSED(SerializeFMUState) UNUSED(SerializedFMUStateSize)
UNUSED(SetBinary) UNUSED(SetClock) UNUSED(SetDebugLogging) UNUSED(SetFMUState) UNUSED(SetFloat32)
UNUSED(SetInt16) UNUSED(SetInt64) UNUSED(SetInt8) UNUSED(SetIntervalDecimal) UNUSED(SetIntervalFraction)
UNUSED(SetShiftDecimal) UNUSED(SetShiftFraction) UNUSED(SetString) UNUSED(SetUInt16) UNUSED(SetUInt32)
UNUSED(SetUInt64) UNUSED(SetUInt8)
