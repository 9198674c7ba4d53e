{% include "c/joint.c" %}

{% include "c/instance.c" %}

// -- FMI 3.0 for co-simulation --------------------------------------------------------------------
#include <stdbool.h>
#include <stdint.h>
#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

typedef void *Fmu;
typedef uint32_t Reference;
typedef const char *String;
typedef const uint8_t *Binary;
typedef bool Clock;
typedef enum { Ok, Warning, Discard, Error, Fatal } Status;

EXPORT String fmi3GetVersion(void) { return "3.0"; }
EXPORT Status fmi3SetDebugLogging(Fmu c, bool on, size_t num, const String names[]) { return Ok; }

// -- life -----------------------------------------------------------------------------------------
EXPORT Fmu fmi3InstantiateCoSimulation(String name, String token, String resources, bool visible,
    bool logging, bool event_mode, bool early_return, const Reference intermediate[], size_t num,
    void *environment, void *log, void *update)
{
    return made(token);
}
EXPORT Fmu fmi3InstantiateModelExchange(String name, String token, String resources, bool visible,
    bool logging, void *environment, void *log)
{
    return NULL;
}
EXPORT Fmu fmi3InstantiateScheduledExecution(String name, String token, String resources,
    bool visible, bool logging, void *environment, void *log, void *update, void *lock, void *unlock)
{
    return NULL;
}
EXPORT void fmi3FreeInstance(Fmu c) { free(c); }
EXPORT Status fmi3EnterInitializationMode(
    Fmu c, bool has_tolerance, double tolerance, double start, bool has_stop, double stop)
{
    ((Instance *)c)->x[TIME] = start;
    return Ok;
}
EXPORT Status fmi3ExitInitializationMode(Fmu c) { return Ok; }
EXPORT Status fmi3EnterConfigurationMode(Fmu c) { return Ok; }
EXPORT Status fmi3ExitConfigurationMode(Fmu c) { return Ok; }
EXPORT Status fmi3Terminate(Fmu c) { return Ok; }
EXPORT Status fmi3Reset(Fmu c)
{
    reset(c);
    return Ok;
}

// -- variables: all are Float64 -------------------------------------------------------------------
EXPORT Status fmi3GetFloat64(
    Fmu c, const Reference which[], size_t num, double values[], size_t num_values)
{
    return num == num_values && read_values(c, which, num, values) ? Ok : Error;
}
EXPORT Status fmi3SetFloat64(
    Fmu c, const Reference which[], size_t num, const double values[], size_t num_values)
{
    return num == num_values && write_values(c, which, num, values) ? Ok : Error;
}
#define NONE_OF(Kind, Type)                                                                        \
    EXPORT Status fmi3Get##Kind(                                                                   \
        Fmu c, const Reference which[], size_t num, Type values[], size_t num_values)              \
    {                                                                                              \
        return num ? Error : Ok;                                                                   \
    }                                                                                              \
    EXPORT Status fmi3Set##Kind(                                                                   \
        Fmu c, const Reference which[], size_t num, const Type values[], size_t num_values)        \
    {                                                                                              \
        return num ? Error : Ok;                                                                   \
    }
NONE_OF(Float32, float)
NONE_OF(Int8, int8_t)
NONE_OF(UInt8, uint8_t)
NONE_OF(Int16, int16_t)
NONE_OF(UInt16, uint16_t)
NONE_OF(Int32, int32_t)
NONE_OF(UInt32, uint32_t)
NONE_OF(Int64, int64_t)
NONE_OF(UInt64, uint64_t)
NONE_OF(Boolean, bool)
NONE_OF(String, String)
EXPORT Status fmi3GetBinary(Fmu c, const Reference which[], size_t num, size_t sizes[],
    Binary values[], size_t num_values)
{
    return num ? Error : Ok;
}
EXPORT Status fmi3SetBinary(Fmu c, const Reference which[], size_t num, const size_t sizes[],
    const Binary values[], size_t num_values)
{
    return num ? Error : Ok;
}
EXPORT Status fmi3GetClock(Fmu c, const Reference which[], size_t num, Clock values[])
{
    return num ? Error : Ok;
}
EXPORT Status fmi3SetClock(Fmu c, const Reference which[], size_t num, const Clock values[])
{
    return num ? Error : Ok;
}
EXPORT Status fmi3GetNumberOfVariableDependencies(Fmu c, Reference which, size_t *num)
{
    *num = 0;
    return Error;
}
EXPORT Status fmi3GetVariableDependencies(Fmu c, Reference which, size_t elements[],
    Reference independents[], size_t independent_elements[], int kinds[], size_t num)
{
    return Error;
}
EXPORT Status fmi3GetDirectionalDerivative(Fmu c, const Reference unknown[], size_t num_unknown,
    const Reference known[], size_t num_known, const double seed[], size_t num_seed, double found[],
    size_t num_found)
{
    if (num_seed != num_known || num_found != num_unknown)
        return Error;
    for (size_t i = 0; i < num_unknown; ++i) {
        found[i] = 0.0;
        for (size_t j = 0; j < num_known; ++j)
            found[i] += seed[j] * slope(c, unknown[i], known[j]);
    }
    return Ok;
}
EXPORT Status fmi3GetAdjointDerivative(Fmu c, const Reference unknown[], size_t num_unknown,
    const Reference known[], size_t num_known, const double seed[], size_t num_seed, double found[],
    size_t num_found)
{
    return Error;
}

// -- states: an instance is its own state ---------------------------------------------------------
EXPORT Status fmi3GetFMUState(Fmu c, void **kept)
{
    if (!*kept)
        *kept = malloc(sizeof(Instance));
    if (!*kept)
        return Error;
    memcpy(*kept, c, sizeof(Instance));
    return Ok;
}
EXPORT Status fmi3SetFMUState(Fmu c, void *kept)
{
    memcpy(c, kept, sizeof(Instance));
    return Ok;
}
EXPORT Status fmi3FreeFMUState(Fmu c, void **kept)
{
    free(*kept);
    *kept = NULL;
    return Ok;
}
EXPORT Status fmi3SerializedFMUStateSize(Fmu c, void *kept, size_t *size)
{
    *size = sizeof(Instance);
    return Ok;
}
EXPORT Status fmi3SerializeFMUState(Fmu c, void *kept, uint8_t bytes[], size_t size)
{
    if (size < sizeof(Instance))
        return Error;
    memcpy(bytes, kept, sizeof(Instance));
    return Ok;
}
EXPORT Status fmi3DeserializeFMUState(Fmu c, const uint8_t bytes[], size_t size, void **kept)
{
    return size == sizeof(Instance) ? fmi3GetFMUState((Fmu)bytes, kept) : Error;
}

// -- steps ----------------------------------------------------------------------------------------
EXPORT Status fmi3EnterStepMode(Fmu c) { return Ok; }
EXPORT Status fmi3DoStep(Fmu c, double time, double step, bool no_return, bool *event,
    bool *terminate, bool *early, double *last)
{
    *event = *terminate = *early = false;
    *last = time + step;
    return stepped(c, time + step) ? Ok : Error;
}
EXPORT Status fmi3GetOutputDerivatives(Fmu c, const Reference which[], size_t num,
    const int32_t orders[], double values[], size_t num_values)
{
    return num ? Error : Ok;
}

// -- what belongs to events, clocks and the other kinds of FMU ------------------------------------
#define NEVER(name, ...)                                                                           \
    EXPORT Status name(__VA_ARGS__) { return Error; }
NEVER(fmi3EnterEventMode, Fmu c)
NEVER(fmi3UpdateDiscreteStates, Fmu c, bool *a, bool *b, bool *d, bool *e, bool *f, double *g)
NEVER(fmi3EvaluateDiscreteStates, Fmu c)
NEVER(fmi3GetIntervalDecimal, Fmu c, const Reference w[], size_t n, double v[], int q[])
NEVER(fmi3GetIntervalFraction, Fmu c, const Reference w[], size_t n, uint64_t a[], uint64_t b[], int q[])
NEVER(fmi3GetShiftDecimal, Fmu c, const Reference w[], size_t n, double v[])
NEVER(fmi3GetShiftFraction, Fmu c, const Reference w[], size_t n, uint64_t a[], uint64_t b[])
NEVER(fmi3SetIntervalDecimal, Fmu c, const Reference w[], size_t n, const double v[])
NEVER(fmi3SetIntervalFraction, Fmu c, const Reference w[], size_t n, const uint64_t a[], const uint64_t b[])
NEVER(fmi3SetShiftDecimal, Fmu c, const Reference w[], size_t n, const double v[])
NEVER(fmi3SetShiftFraction, Fmu c, const Reference w[], size_t n, const uint64_t a[], const uint64_t b[])
NEVER(fmi3EnterContinuousTimeMode, Fmu c)
NEVER(fmi3CompletedIntegratorStep, Fmu c, bool no_return, bool *event, bool *terminate)
NEVER(fmi3SetTime, Fmu c, double time)
NEVER(fmi3SetContinuousStates, Fmu c, const double x[], size_t n)
NEVER(fmi3GetContinuousStates, Fmu c, double x[], size_t n)
NEVER(fmi3GetContinuousStateDerivatives, Fmu c, double x[], size_t n)
NEVER(fmi3GetNominalsOfContinuousStates, Fmu c, double x[], size_t n)
NEVER(fmi3GetEventIndicators, Fmu c, double x[], size_t n)
NEVER(fmi3GetNumberOfEventIndicators, Fmu c, size_t *n)
NEVER(fmi3GetNumberOfContinuousStates, Fmu c, size_t *n)
NEVER(fmi3ActivateModelPartition, Fmu c, Reference clock, double time)
