/* Co-simulation of a robot by FMI 3: torque in, positions, velocities and accelerations out.

   model.h, which is generated, has the robot's equation of motion. Every internal step is Moreau's: forces at the
   middle of the step, dry friction implicit. A joint that friction holds stands still; it does not creep or tremble. */

#include "model.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined _WIN32
#define FMI_EXPORT __declspec(dllexport)
#else
#define FMI_EXPORT __attribute__((visibility("default")))
#endif

/* Types of FMI 3.0 (https://fmi-standard.org/docs/3.0) */
typedef void *fmi3Instance, *fmi3InstanceEnvironment, *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef float fmi3Float32;
typedef double fmi3Float64;
typedef int8_t fmi3Int8;
typedef uint8_t fmi3UInt8;
typedef int16_t fmi3Int16;
typedef uint16_t fmi3UInt16;
typedef int32_t fmi3Int32;
typedef uint32_t fmi3UInt32;
typedef int64_t fmi3Int64;
typedef uint64_t fmi3UInt64;
typedef bool fmi3Boolean, fmi3Clock;
typedef const char *fmi3String;
typedef uint8_t fmi3Byte;
typedef const fmi3Byte *fmi3Binary;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef int fmi3DependencyKind, fmi3IntervalQualifier;
typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment, fmi3Status, fmi3String, fmi3String);
typedef void (*fmi3IntermediateUpdateCallback)(void);

enum { N = FMU_JOINTS, ITERATIONS = 200 };
enum { TIME = 0, TAU = 1000, Q = 2000, DQ = 3000, DDQ = 4000, PAYLOAD = 5000, TEMPERATURE = 6000, RUNS = 7000, STEP = 8000 };

/* All that changes; a state of the FMU is a copy. */
typedef struct {
    double time, step;
    double tau[N], q[N], dq[N], ddq[N], friction[N];
    double payload[10]; /* mass, centre, inertia about the centre: xx, xy, xz, yy, yz, zz */
    double temperature[N], runs[FMU_RUNS + 1];
    fmu_state state;
} variables;

typedef struct {
    variables now;
    fmu_parameters parameters;
    bool initialized;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} instance;

static fmi3Status fail(const instance *m, const char *message)
{
    if (m->log) m->log(m->environment, fmi3Error, "logStatusError", message);
    return fmi3Error;
}

static void reset(instance *m)
{
    int j;
    memset(&m->now, 0, sizeof m->now);
    m->now.step = FMU_STEP;
    for (j = 0; j < N; j++) m->now.temperature[j] = FMU_TEMPERATURE;
    fmu_start(&m->now.state);
    m->parameters = fmu_identified();
    m->initialized = false;
}

/* Lower triangle of the Cholesky factor, in place; false if the matrix is not positive definite */
static bool factorize(double a[N][N])
{
    int i, j, k;
    for (j = 0; j < N; j++) {
        for (i = j; i < N; i++) {
            double sum = a[i][j];
            for (k = 0; k < j; k++) sum -= a[i][k] * a[j][k];
            if (i == j && !(sum > 0.0)) return false;
            a[i][j] = i == j ? sqrt(sum) : sum / a[j][j];
        }
    }
    return true;
}

static void solve(double factor[N][N], double x[N])
{
    int i, k;
    for (i = 0; i < N; i++) {
        for (k = 0; k < i; k++) x[i] -= factor[i][k] * x[k];
        x[i] /= factor[i][i];
    }
    for (i = N - 1; i >= 0; i--) {
        for (k = i + 1; k < N; k++) x[i] -= factor[k][i] * x[k];
        x[i] /= factor[i][i];
    }
}

/* One step of length h */
static bool advance(variables *v, const fmu_parameters *parameters, double h)
{
    double middle[N], moving[N], terms[N * (N + 2)], mass[N][N], inverse[N][N], speed[N], limit[N];
    int i, j, k;
    for (j = 0; j < N; j++) {
        middle[j] = v->q[j] + 0.5 * h * v->dq[j];
        /* The friction of a joint that stands is that with which its motion would begin. */
        moving[j] = fabs(v->dq[j]) > 1e-9 ? v->dq[j] : v->friction[j] < 0.0 ? -1e-9 : 1e-9;
        /* The velocity in the middle of the step, unless the joint may stop before */
        if ((v->dq[j] + h * v->ddq[j]) * v->dq[j] > 0.0) moving[j] = v->dq[j] + 0.5 * h * v->ddq[j];
    }
    fmu_advance(&v->state, middle);
    fmu_terms(parameters, middle, moving, v->ddq, v->time + 0.5 * h, h, v->temperature, v->runs, &v->state, terms);
    for (i = 0; i < N; i++)
        for (j = 0; j < N; j++) mass[i][j] = terms[i * N + j];
    if (!factorize(mass)) return false;
    for (k = 0; k < N; k++) {
        for (j = 0; j < N; j++) inverse[k][j] = j == k ? 1.0 : 0.0;
        solve(mass, inverse[k]);
    }
    for (j = 0; j < N; j++) {
        const double direction = moving[j] < 0.0 ? -1.0 : 1.0, friction = terms[N * (N + 1) + j];
        /* Friction resists. What would drive the joint is a force like others. */
        limit[j] = direction * friction > 0.0 ? direction * friction : 0.0;
        speed[j] = v->tau[j] - terms[N * N + j] - (friction - direction * limit[j]);
    }
    solve(mass, speed);
    for (j = 0; j < N; j++) speed[j] = v->dq[j] + h * speed[j];
    for (j = 0; j < N; j++) {
        if (v->friction[j] > limit[j]) v->friction[j] = limit[j];
        if (v->friction[j] < -limit[j]) v->friction[j] = -limit[j];
        for (i = 0; i < N; i++) speed[i] -= h * inverse[i][j] * v->friction[j];
    }
    /* Coulomb's law at the end of the step, joint by joint: velocity zero, or friction at its limit against it */
    for (k = 0; k < ITERATIONS; k++) {
        double largest = 0.0;
        for (j = 0; j < N; j++) {
            double force = v->friction[j] + speed[j] / (h * inverse[j][j]), change;
            if (force > limit[j]) force = limit[j];
            if (force < -limit[j]) force = -limit[j];
            change = force - v->friction[j];
            v->friction[j] = force;
            for (i = 0; i < N; i++) speed[i] -= h * inverse[i][j] * change;
            if (fabs(change) * h * inverse[j][j] > largest) largest = fabs(change) * h * inverse[j][j];
        }
        if (largest < 1e-12) break;
    }
    for (j = 0; j < N; j++) {
        v->ddq[j] = (speed[j] - v->dq[j]) / h;
        v->dq[j] = speed[j];
        v->q[j] = middle[j] + 0.5 * h * speed[j];
    }
    v->time += h;
    return true;
}

/* A variable by its reference, or NULL */
static double *find(variables *v, fmi3ValueReference reference)
{
    const fmi3ValueReference block = reference / 1000 * 1000, k = reference % 1000;
    switch (block) {
    case TIME: return k == 0 ? &v->time : NULL;
    case TAU: return k < N ? &v->tau[k] : NULL;
    case Q: return k < N ? &v->q[k] : NULL;
    case DQ: return k < N ? &v->dq[k] : NULL;
    case DDQ: return k < N ? &v->ddq[k] : NULL;
    case PAYLOAD: return k < 10 ? &v->payload[k] : NULL;
    case TEMPERATURE: return k < N ? &v->temperature[k] : NULL;
    case RUNS: return (int)k < FMU_RUNS ? &v->runs[k] : NULL;
    case STEP: return k == 0 ? &v->step : NULL;
    default: return NULL;
    }
}

static void set_payload(instance *m)
{
    const double *payload = m->now.payload;
    fmu_set_payload(&m->parameters, payload[0], payload + 1, payload + 4);
}

FMI_EXPORT const char *fmi3GetVersion(void) { return "3.0"; }

FMI_EXPORT fmi3Status fmi3SetDebugLogging(fmi3Instance m, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    (void)m, (void)on, (void)n, (void)categories;
    return fmi3OK;
}

FMI_EXPORT fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3Boolean events, fmi3Boolean early_return, const fmi3ValueReference intermediate[], size_t n_intermediate,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    instance *m;
    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early_return;
    (void)intermediate, (void)n_intermediate, (void)update;
    if (!token || strcmp(token, FMU_TOKEN) != 0) {
        if (log) log(environment, fmi3Error, "logStatusError", "The instantiation token is not that of this FMU.");
        return NULL;
    }
    m = malloc(sizeof *m);
    if (!m) return NULL;
    m->environment = environment;
    m->log = log;
    reset(m);
    return m;
}

FMI_EXPORT void fmi3FreeInstance(fmi3Instance m) { free(m); }

FMI_EXPORT fmi3Status fmi3EnterInitializationMode(
    fmi3Instance c, fmi3Boolean has_tolerance, fmi3Float64 tolerance, fmi3Float64 start, fmi3Boolean has_stop,
    fmi3Float64 stop)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    ((instance *)c)->now.time = start;
    return fmi3OK;
}

/* The accelerations at the start, of what is set so far: those of a step that is not made */
static fmi3Status compute_start(instance *m)
{
    variables tried;
    set_payload(m);
    fmu_start(&m->now.state);
    fmu_advance(&m->now.state, m->now.q);
    memset(m->now.ddq, 0, sizeof m->now.ddq);
    tried = m->now;
    if (!advance(&tried, &m->parameters, 1e-6)) return fail(m, "The mass matrix is not positive definite.");
    memcpy(m->now.ddq, tried.ddq, sizeof tried.ddq);
    return fmi3OK;
}

FMI_EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance c)
{
    instance *m = c;
    const fmi3Status status = compute_start(m);
    m->initialized = status == fmi3OK;
    return status;
}

FMI_EXPORT fmi3Status fmi3Terminate(fmi3Instance m)
{
    (void)m;
    return fmi3OK;
}

FMI_EXPORT fmi3Status fmi3Reset(fmi3Instance m)
{
    reset(m);
    return fmi3OK;
}

FMI_EXPORT fmi3Status fmi3GetFloat64(
    fmi3Instance c, const fmi3ValueReference references[], size_t n, fmi3Float64 values[], size_t n_values)
{
    instance *m = c;
    size_t k;
    bool started = m->initialized;
    if (n != n_values) return fail(m, "There are as many values as references.");
    for (k = 0; k < n; k++) {
        /* Masters may ask for accelerations before the initialization ends. */
        if (!started && references[k] / 1000 * 1000 == DDQ) {
            if (compute_start(m) != fmi3OK) return fmi3Error;
            started = true;
        }
        const double *place = find(&m->now, references[k]);
        if (!place) return fail(m, "There is no variable with this reference.");
        values[k] = *place;
    }
    return fmi3OK;
}

FMI_EXPORT fmi3Status fmi3SetFloat64(
    fmi3Instance c, const fmi3ValueReference references[], size_t n, const fmi3Float64 values[], size_t n_values)
{
    instance *m = c;
    size_t k;
    if (n != n_values) return fail(m, "There are as many values as references.");
    for (k = 0; k < n; k++) {
        double *place = find(&m->now, references[k]);
        const fmi3ValueReference block = references[k] / 1000 * 1000;
        if (!place || block == TIME || block == DDQ) return fail(m, "This variable cannot be set.");
        if (m->initialized && (block == Q || block == DQ))
            return fail(m, "Positions and velocities can be set before the end of the initialization only.");
        if (!isfinite(values[k])) return fail(m, "Values must be finite.");
        if (block == STEP && !(values[k] > 0.0)) return fail(m, "The step must be positive.");
        *place = values[k];
    }
    set_payload(m);
    return fmi3OK;
}

FMI_EXPORT fmi3Status fmi3DoStep(
    fmi3Instance c, fmi3Float64 time, fmi3Float64 length, fmi3Boolean no_return, fmi3Boolean *event,
    fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last)
{
    instance *m = c;
    double steps, k;
    (void)no_return;
    if (!(length > 0.0)) return fail(m, "The length of a step must be positive.");
    m->now.time = time;
    steps = ceil(length / m->now.step - 1e-9);
    if (steps < 1.0) steps = 1.0;
    for (k = 0.0; k < steps; k++)
        if (!advance(&m->now, &m->parameters, length / steps)) return fail(m, "The mass matrix is not positive definite.");
    m->now.time = time + length;
    *event = *terminate = *early = false;
    *last = m->now.time;
    return fmi3OK;
}

FMI_EXPORT fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state)
{
    if (!*state) *state = malloc(sizeof(instance));
    if (!*state) return fail(c, "There is no memory for the state.");
    memcpy(*state, c, sizeof(instance));
    return fmi3OK;
}

FMI_EXPORT fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state)
{
    instance *m = c;
    const instance before = *m;
    *m = *(const instance *)state;
    m->environment = before.environment;
    m->log = before.log;
    return fmi3OK;
}

FMI_EXPORT fmi3Status fmi3FreeFMUState(fmi3Instance m, fmi3FMUState *state)
{
    (void)m;
    free(*state);
    *state = NULL;
    return fmi3OK;
}

/* What a co-simulation of this kind does not need */
#define REFUSE(name, ...) \
    FMI_EXPORT fmi3Status name(fmi3Instance m, __VA_ARGS__) { return fail(m, #name " is not supported by this FMU."); }
#define REFUSE_TYPE(type) \
    REFUSE(fmi3Get##type, const fmi3ValueReference r[], size_t n, fmi3##type v[], size_t k) \
    REFUSE(fmi3Set##type, const fmi3ValueReference r[], size_t n, const fmi3##type v[], size_t k)
#if defined __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
REFUSE_TYPE(Float32)
REFUSE_TYPE(Int8)
REFUSE_TYPE(UInt8)
REFUSE_TYPE(Int16)
REFUSE_TYPE(UInt16)
REFUSE_TYPE(Int32)
REFUSE_TYPE(UInt32)
REFUSE_TYPE(Int64)
REFUSE_TYPE(UInt64)
REFUSE_TYPE(Boolean)
REFUSE_TYPE(String)
REFUSE(fmi3GetBinary, const fmi3ValueReference r[], size_t n, size_t sizes[], fmi3Binary v[], size_t k)
REFUSE(fmi3SetBinary, const fmi3ValueReference r[], size_t n, const size_t sizes[], const fmi3Binary v[], size_t k)
REFUSE(fmi3GetClock, const fmi3ValueReference r[], size_t n, fmi3Clock v[])
REFUSE(fmi3SetClock, const fmi3ValueReference r[], size_t n, const fmi3Clock v[])
REFUSE(fmi3GetNumberOfVariableDependencies, fmi3ValueReference r, size_t *n)
REFUSE(fmi3GetVariableDependencies, fmi3ValueReference r, size_t a[], fmi3ValueReference b[], size_t c[],
       fmi3DependencyKind d[], size_t n)
REFUSE(fmi3SerializedFMUStateSize, fmi3FMUState s, size_t *n)
REFUSE(fmi3SerializeFMUState, fmi3FMUState s, fmi3Byte bytes[], size_t n)
REFUSE(fmi3DeserializeFMUState, const fmi3Byte bytes[], size_t n, fmi3FMUState *s)
REFUSE(fmi3GetDirectionalDerivative, const fmi3ValueReference u[], size_t nu, const fmi3ValueReference k[], size_t nk,
       const fmi3Float64 s[], size_t ns, fmi3Float64 v[], size_t nv)
REFUSE(fmi3GetAdjointDerivative, const fmi3ValueReference u[], size_t nu, const fmi3ValueReference k[], size_t nk,
       const fmi3Float64 s[], size_t ns, fmi3Float64 v[], size_t nv)
REFUSE(fmi3GetOutputDerivatives, const fmi3ValueReference r[], size_t n, const fmi3Int32 o[], fmi3Float64 v[], size_t k)
REFUSE(fmi3GetIntervalDecimal, const fmi3ValueReference r[], size_t n, fmi3Float64 v[], fmi3IntervalQualifier q[])
REFUSE(fmi3GetIntervalFraction, const fmi3ValueReference r[], size_t n, fmi3UInt64 v[], fmi3UInt64 d[],
       fmi3IntervalQualifier q[])
REFUSE(fmi3GetShiftDecimal, const fmi3ValueReference r[], size_t n, fmi3Float64 v[])
REFUSE(fmi3GetShiftFraction, const fmi3ValueReference r[], size_t n, fmi3UInt64 v[], fmi3UInt64 d[])
REFUSE(fmi3SetIntervalDecimal, const fmi3ValueReference r[], size_t n, const fmi3Float64 v[])
REFUSE(fmi3SetIntervalFraction, const fmi3ValueReference r[], size_t n, const fmi3UInt64 v[], const fmi3UInt64 d[])
REFUSE(fmi3SetShiftDecimal, const fmi3ValueReference r[], size_t n, const fmi3Float64 v[])
REFUSE(fmi3SetShiftFraction, const fmi3ValueReference r[], size_t n, const fmi3UInt64 v[], const fmi3UInt64 d[])
REFUSE(fmi3UpdateDiscreteStates, fmi3Boolean *a, fmi3Boolean *b, fmi3Boolean *c, fmi3Boolean *d, fmi3Boolean *e,
       fmi3Float64 *t)
REFUSE(fmi3CompletedIntegratorStep, fmi3Boolean a, fmi3Boolean *b, fmi3Boolean *c)
REFUSE(fmi3SetTime, fmi3Float64 t)
REFUSE(fmi3SetContinuousStates, const fmi3Float64 x[], size_t n)
REFUSE(fmi3GetContinuousStateDerivatives, fmi3Float64 x[], size_t n)
REFUSE(fmi3GetEventIndicators, fmi3Float64 x[], size_t n)
REFUSE(fmi3GetContinuousStates, fmi3Float64 x[], size_t n)
REFUSE(fmi3GetNominalsOfContinuousStates, fmi3Float64 x[], size_t n)
REFUSE(fmi3GetNumberOfEventIndicators, size_t *n)
REFUSE(fmi3GetNumberOfContinuousStates, size_t *n)
REFUSE(fmi3ActivateModelPartition, fmi3ValueReference r, fmi3Float64 t)

#define REFUSE_MODE(name) \
    FMI_EXPORT fmi3Status name(fmi3Instance m) { return fail(m, #name " is not supported by this FMU."); }
REFUSE_MODE(fmi3EnterEventMode)
REFUSE_MODE(fmi3EnterStepMode)
REFUSE_MODE(fmi3EnterConfigurationMode)
REFUSE_MODE(fmi3ExitConfigurationMode)
REFUSE_MODE(fmi3EvaluateDiscreteStates)
REFUSE_MODE(fmi3EnterContinuousTimeMode)

FMI_EXPORT fmi3Instance fmi3InstantiateModelExchange(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    if (log) log(environment, fmi3Error, "logStatusError", "This FMU is for co-simulation.");
    return NULL;
}

FMI_EXPORT fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, void (*clock)(void), void (*lock)(void),
    void (*unlock)(void))
{
    if (log) log(environment, fmi3Error, "logStatusError", "This FMU is for co-simulation.");
    return NULL;
}
