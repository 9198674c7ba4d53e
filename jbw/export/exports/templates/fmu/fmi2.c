{% include "c/joint.c" %}

{% include "c/instance.c" %}

// -- FMI 2.0 for co-simulation --------------------------------------------------------------------
#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

typedef void *Component;
typedef unsigned Reference;
typedef int Boolean;
typedef const char *String;
typedef enum { Ok, Warning, Discard, Error, Fatal, Pending } Status;

EXPORT String fmi2GetTypesPlatform(void) { return "default"; }
EXPORT String fmi2GetVersion(void) { return "2.0"; }
EXPORT Status fmi2SetDebugLogging(Component c, Boolean on, size_t num, const String names[])
{
    return Ok;
}

// -- life -----------------------------------------------------------------------------------------
EXPORT Component fmi2Instantiate(String name, int kind, String guid, String resources,
    const void *functions, Boolean visible, Boolean logging)
{
    return kind == 1 ? made(guid) : NULL;
}
EXPORT void fmi2FreeInstance(Component c) { free(c); }
EXPORT Status fmi2SetupExperiment(
    Component c, Boolean has_tolerance, double tolerance, double start, Boolean has_stop, double stop)
{
    ((Instance *)c)->x[TIME] = start;
    return Ok;
}
EXPORT Status fmi2EnterInitializationMode(Component c) { return Ok; }
EXPORT Status fmi2ExitInitializationMode(Component c) { return Ok; }
EXPORT Status fmi2Terminate(Component c) { return Ok; }
EXPORT Status fmi2Reset(Component c)
{
    reset(c);
    return Ok;
}

// -- variables: all are real ----------------------------------------------------------------------
EXPORT Status fmi2GetReal(Component c, const Reference which[], size_t num, double values[])
{
    return read_values(c, which, num, values) ? Ok : Error;
}
EXPORT Status fmi2SetReal(Component c, const Reference which[], size_t num, const double values[])
{
    return write_values(c, which, num, values) ? Ok : Error;
}
#define NONE_OF(Kind, Type)                                                                        \
    EXPORT Status fmi2Get##Kind(Component c, const Reference which[], size_t num, Type values[])   \
    {                                                                                              \
        return num ? Error : Ok;                                                                   \
    }                                                                                              \
    EXPORT Status fmi2Set##Kind(                                                                   \
        Component c, const Reference which[], size_t num, const Type values[])                     \
    {                                                                                              \
        return num ? Error : Ok;                                                                   \
    }
NONE_OF(Integer, int)
NONE_OF(Boolean, Boolean)
NONE_OF(String, String)
EXPORT Status fmi2GetDirectionalDerivative(Component c, const Reference unknown[], size_t num_unknown,
    const Reference known[], size_t num_known, const double by[], double found[])
{
    for (size_t i = 0; i < num_unknown; ++i) {
        found[i] = 0.0;
        for (size_t j = 0; j < num_known; ++j)
            found[i] += by[j] * slope(c, unknown[i], known[j]);
    }
    return Ok;
}

// -- states: an instance is its own state ---------------------------------------------------------
EXPORT Status fmi2GetFMUstate(Component c, void **kept)
{
    if (!*kept)
        *kept = malloc(sizeof(Instance));
    if (!*kept)
        return Error;
    memcpy(*kept, c, sizeof(Instance));
    return Ok;
}
EXPORT Status fmi2SetFMUstate(Component c, void *kept)
{
    memcpy(c, kept, sizeof(Instance));
    return Ok;
}
EXPORT Status fmi2FreeFMUstate(Component c, void **kept)
{
    free(*kept);
    *kept = NULL;
    return Ok;
}
EXPORT Status fmi2SerializedFMUstateSize(Component c, void *kept, size_t *size)
{
    *size = sizeof(Instance);
    return Ok;
}
EXPORT Status fmi2SerializeFMUstate(Component c, void *kept, char bytes[], size_t size)
{
    if (size < sizeof(Instance))
        return Error;
    memcpy(bytes, kept, sizeof(Instance));
    return Ok;
}
EXPORT Status fmi2DeSerializeFMUstate(Component c, const char bytes[], size_t size, void **kept)
{
    return size == sizeof(Instance) ? fmi2GetFMUstate((Component)bytes, kept) : Error;
}

// -- steps ----------------------------------------------------------------------------------------
EXPORT Status fmi2DoStep(Component c, double time, double step, Boolean no_return)
{
    return stepped(c, time + step) ? Ok : Error;
}
EXPORT Status fmi2CancelStep(Component c) { return Error; }
EXPORT Status fmi2SetRealInputDerivatives(
    Component c, const Reference which[], size_t num, const int order[], const double values[])
{
    return num ? Error : Ok;
}
EXPORT Status fmi2GetRealOutputDerivatives(
    Component c, const Reference which[], size_t num, const int order[], double values[])
{
    return num ? Error : Ok;
}
EXPORT Status fmi2GetStatus(Component c, int kind, Status *value) { return Discard; }
EXPORT Status fmi2GetRealStatus(Component c, int kind, double *value)
{
    *value = ((Instance *)c)->x[TIME];
    return kind == 2 ? Ok : Discard;
}
EXPORT Status fmi2GetIntegerStatus(Component c, int kind, int *value) { return Discard; }
EXPORT Status fmi2GetBooleanStatus(Component c, int kind, Boolean *value)
{
    *value = 0;
    return kind == 3 ? Ok : Discard;
}
EXPORT Status fmi2GetStringStatus(Component c, int kind, String *value) { return Discard; }
