{% include "c/joint.c" %}

// -- Abaqus/Standard: UEL, a joint of two nodes along one degree of freedom ------------------------
// Beside the laws' force stand the spring and the dashpot of the properties; the mass only scales
// the laws. Checked by a driver of our own that calls UEL from Fortran, not in Abaqus itself.
#if defined __has_include
#if __has_include(<aba_for_c.h>)
#include <aba_for_c.h>
#endif
#endif
#ifndef FOR_NAME
#define FOR_NAME(lower, upper) lower##_
#endif
#ifdef __cplusplus
#define ENTRY extern "C" void
#else
#define ENTRY void
#endif

// Residual and matrix of the two nodes.
static void put(double *rhs, double *matrix, double residual, double stiffness)
{
    for (int i = 0; i < 2; ++i) {
        rhs[i] = i ? -residual : residual;
        for (int j = 0; j < 2; ++j)
            matrix[i + 2 * j] = i == j ? stiffness : -stiffness;
    }
}

// SVARS: the joint's state and its force after the last increment, then those after the one before.
enum { NUM_KEPT = NUM_STATES + 1 };

ENTRY FOR_NAME(uel, UEL)(double *rhs, double *amatrx, double *svars, double *energy,
    const int *ndofel, const int *nrhs, const int *nsvars, const double *props, const int *nprops,
    const double *coords, const int *mcrd, const int *nnode, const double *u, const double *du,
    const double *v, const double *a, const int *jtype, const double *time, const double *dtime,
    const int *kstep, const int *kinc, const int *jelem, const double *params, const int *ndload,
    const int *jdltyp, const double *adlmag, const double *predef, const int *npredf,
    const int *lflags, const int *mlvarx, const double *ddlmag, const int *mdload, double *pnewdt,
    const int *jprops, const int *njprop, const double *period)
{
    double state[NUM_STATES], y = u[1] - u[0], w = v[1] - v[0];
    int dynamic = lflags[0] == 11 || lflags[0] == 12, task = lflags[2];
    double hht = dynamic ? params[0] : 0.0, by_rate = 0.0;
    if (!dynamic) // of the increment: a static step has no velocity
        w = *dtime > 0.0 ? (du[1] - du[0]) / *dtime : 0.0;
    if (*dtime > 0.0)
        by_rate = dynamic ? params[2] / (params[1] * *dtime) : 1.0 / *dtime;
    // Half an increment on is asked for when the increment is over: it goes on from its start.
    for (int i = 0; i < NUM_STATES; ++i)
        state[i] = svars[i + (task == 5 ? NUM_KEPT : 0)];
    double now = svars[NUM_STATES], before = svars[NUM_KEPT + NUM_STATES];

    Force found = joint_force(props, state, y, w);
    double force = found.force + props[SPRING] * y + props[DASHPOT] * w;
    double by_y = found.by_y + props[SPRING], by_v = found.by_v + props[DASHPOT];
    for (int i = 0; i < 2 * *nrhs; ++i)
        rhs[i % 2 + i / 2 * *mlvarx] = 0.0;
    for (int i = 0; i < 4; ++i)
        amatrx[i] = 0.0;

    if (task == 1) { // an increment
        put(rhs, amatrx, (1.0 + hht) * force - hht * now, (1.0 + hht) * (by_y + by_rate * by_v));
        for (int i = 0; i < NUM_KEPT; ++i) {
            svars[NUM_KEPT + i] = svars[i];
            svars[i] = i < NUM_STATES ? state[i] : force;
        }
        energy[1] = 0.5 * props[SPRING] * y * y;
    } else if (task == 2) { // the stiffness alone
        put(rhs, amatrx, 0.0, by_y);
    } else if (task == 3) { // the damping alone
        put(rhs, amatrx, 0.0, by_v);
    } else if (task == 5) { // the residual half an increment on
        double residual = (1.0 + hht) * force - 0.5 * hht * (now + before), none[4];
        put(rhs, none, residual, 0.0);
    } else if (task == 6) { // where the accelerations begin: there is no mass
        double none[4];
        put(rhs, none, force, 0.0);
        svars[NUM_STATES] = svars[NUM_KEPT + NUM_STATES] = force;
    }
}
