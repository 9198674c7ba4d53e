// One instance of the FMU: its variables by value reference, and the state of the joint.
#include <stdlib.h>
#include <string.h>

enum { TIME, DISPLACEMENT, VELOCITY, FORCE, TOTAL_FORCE, FIRST_PARAMETER };
enum { NUM_VARIABLES = FIRST_PARAMETER + NUM_PARAMETERS };

typedef struct {
    double x[NUM_VARIABLES], state[NUM_STATES];
} Instance;

static const double START[NUM_VARIABLES] = {
    0.0, 0.0, 0.0, 0.0, 0.0,
{% for one in parameters %}
    {{ one.value | number }}, // {{ one.name }}
{% endfor %}
};

static void reset(Instance *one)
{
    memcpy(one->x, START, sizeof START);
    memset(one->state, 0, sizeof one->state);
}

static Instance *made(const char *token)
{
    Instance *one = strcmp(token, "{{ token }}") ? NULL : malloc(sizeof *one);
    if (one)
        reset(one);
    return one;
}

// Moves the joint to the displacement that was set last.
static Force moved(Instance *one)
{
    return joint_force(
        one->x + FIRST_PARAMETER, one->state, one->x[DISPLACEMENT], one->x[VELOCITY]);
}

// The outputs belong to the inputs as they are; only a step changes the memory.
static Force refreshed(Instance *one)
{
    Instance trial = *one;
    Force found = moved(&trial);
    const double *p = one->x + FIRST_PARAMETER;
    one->x[FORCE] = found.force;
    one->x[TOTAL_FORCE] = found.force + p[SPRING] * one->x[DISPLACEMENT]
        + p[DASHPOT] * one->x[VELOCITY];
    return found;
}

static int read_values(Instance *one, const unsigned *which, size_t num, double *values)
{
    refreshed(one);
    for (size_t i = 0; i < num; ++i) {
        if (which[i] >= NUM_VARIABLES)
            return 0;
        values[i] = one->x[which[i]];
    }
    return 1;
}

static int write_values(Instance *one, const unsigned *which, size_t num, const double *values)
{
    for (size_t i = 0; i < num; ++i) {
        int settable = which[i] == DISPLACEMENT || which[i] == VELOCITY
            || (which[i] >= FIRST_PARAMETER && which[i] < NUM_VARIABLES);
        if (!settable || !isfinite(values[i]))
            return 0;
        one->x[which[i]] = values[i];
    }
    return 1;
}

// Ends a step of any length: the joint stays where the inputs have brought it.
static int stepped(Instance *one, double time)
{
    Force found = moved(one);
    one->x[TIME] = time;
    return isfinite(found.force) != 0;
}

// Slope of an output with an input.
static double slope(Instance *one, unsigned output, unsigned input)
{
    Force found = refreshed(one);
    const double *p = one->x + FIRST_PARAMETER;
    int total = output == TOTAL_FORCE;
    if (output != FORCE && !total)
        return 0.0;
    if (input == DISPLACEMENT)
        return found.by_y + (total ? p[SPRING] : 0.0);
    return input == VELOCITY ? found.by_v + (total ? p[DASHPOT] : 0.0) : 0.0;
}
