{{ about | commented("// ") }}
// Force of the joint after monotone moves, exact: laws {{ laws | join(", ") or "none" }}.
// C99, double precision, SI units; written by jbw {{ version }}.
#include <math.h>
#include <stddef.h>

// Force of one law [N/kg] and its slopes with displacement [1/s^2] and velocity [1/s].
typedef struct {
    double force, by_y, by_v;
} Force;

// A law's force after a monotone move of the displacement, which changes its memory.
typedef Force (*Law)(int num, const double *p, double *memory, double from, double to, double v);

{% include "c/branches.c" %}

{% for form in forms %}
{% include form.file %}

{% endfor %}
// Parameters of the whole joint, in this order; those of the laws follow.
enum { MASS, SPRING, DASHPOT, FIRST_OF_LAWS };
enum { NUM_PARAMETERS = {{ parameters | length }}, NUM_STATES = {{ 1 + memory }} };
{% if forms %}
static const struct {
    Law law;
    int num, memory;
} LAWS[] = {
{% for form in forms %}
    { {{- form.name }}, {{ form.num }}, {{ form.memory -}} },
{% endfor %}
};
enum { NUM_LAWS = sizeof LAWS / sizeof LAWS[0] };
{% endif %}

// Force of all laws of the joint [N] at the displacement y [m] and velocity v [m/s].
// The state is the last displacement and the memories, all zero at rest.
static Force joint_force(const double *p, double *state, double y, double v)
{
    Force total = {0.0, 0.0, 0.0};
{% if forms %}
    const double *own = p + FIRST_OF_LAWS;
    double *memory = state + 1;
    for (int i = 0; i < NUM_LAWS; ++i) {
        Force one = LAWS[i].law(LAWS[i].num, own, memory, state[0], y, v);
        total.force += p[MASS] * one.force;
        total.by_y += p[MASS] * one.by_y;
        total.by_v += p[MASS] * one.by_v;
        own += LAWS[i].num;
        memory += LAWS[i].memory;
    }
{% endif %}
    state[0] = y;
    return total;
}
