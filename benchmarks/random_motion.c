/* Displacement of a joint under random force, per unit modal mass, without jbw.
   Force samples u at intervals of h; cubic interpolation between them gives RK4's midpoints, and four
   steps of the leap-frog a sample for sliders, whose force is followed along straight moves.
   Laws: 0 Bouc-Wen (alpha, delta, gamma); 1 one slider (stiffness, slip); 2 Iwan's four parameters
   (K_T, chi, phi_max, c, F_S) by Masing's rules, with a stack of reversals. */
#include <math.h>

#define DEPTH 65536

typedef struct { long count; double direction, y[DEPTH], f[DEPTH]; } Reversals;

static double virgin(const double *p, double x)
{
    double a = fabs(x), force = a >= p[2] ? p[4] : p[0] * a - p[3] * pow(a, 2 + p[1]);
    return x < 0 ? -force : force;
}

static double moved(const double *p, Reversals *m, double y_old, double f_old, double y)
{
    double direction = y > y_old ? 1 : -1;
    long n;
    if (y == y_old) return f_old;
    if (m->direction != 0 && direction != m->direction && m->count < DEPTH) {
        m->y[m->count] = y_old;
        m->f[m->count++] = f_old;
    }
    m->direction = direction;
    /* A branch that reaches the reversal before its own closes: both are forgotten. */
    while (m->count >= 2 && (y - m->y[m->count - 2]) * direction >= 0) m->count -= 2;
    if (m->count == 1 && fabs(y) >= fabs(m->y[0])) m->count = 0;
    n = m->count;
    return n ? m->f[n - 1] + 2 * virgin(p, 0.5 * (y - m->y[n - 1])) : virgin(p, y);
}

static double between(const double *u, double s) /* Lagrange's cubic through u[-1] .. u[2] */
{
    return -s * (s - 1) * (s - 2) / 6 * u[-1] + (s + 1) * (s - 1) * (s - 2) / 2 * u[0]
         - (s + 1) * s * (s - 2) / 2 * u[1] + (s + 1) * s * (s - 1) / 6 * u[2];
}

/* u has n + 3 samples; state is y, v, force; sums of y^2, v^2, y^4 over n samples. */
void motion(long law, const double *p, double k, double c, const double *u, long n, double h,
            double *state, double *sums)
{
    static Reversals m;
    double y = state[0], v = state[1], f = state[2];
    if (state[3] == 0) { m.count = 0; m.direction = 0; state[3] = 1; }
    for (long i = 0; i < n; i++, u++) {
        if (law == 0) {
            double load[4] = {u[1], between(u + 1, 0.5), 0, u[2]}, part[4] = {0, 0.5, 0.5, 1};
            double dy = 0, dv = 0, df = 0, sy = 0, sv = 0, sf = 0;
            load[2] = load[1];
            for (int s = 0; s < 4; s++) {
                double w = s == 1 || s == 2 ? 2 : 1;
                double ys = y + part[s] * h * dy, vs = v + part[s] * h * dv, fs = f + part[s] * h * df;
                dy = vs;
                dv = load[s] - c * vs - k * ys - fs;
                df = p[0] * vs - p[2] * fabs(vs) * fs - p[1] * vs * fabs(fs);
                sy += w * dy; sv += w * dv; sf += w * df;
            }
            y += h / 6 * sy; v += h / 6 * sv; f += h / 6 * sf;
        } else {
            double step = 0.25 * h;
            for (int s = 0; s < 4; s++) {
                double half = v + 0.5 * step * (between(u + 1, 0.25 * s) - c * v - k * y - f);
                double ahead = y + step * half;
                if (law == 1) {
                    double tried = f + p[0] * (ahead - y), most = p[0] * p[1];
                    f = tried > most ? most : tried < -most ? -most : tried;
                } else
                    f = moved(p, &m, y, f, ahead);
                y = ahead;
                v = (half + 0.5 * step * (between(u + 1, 0.25 * (s + 1)) - k * y - f))
                    / (1 + 0.5 * step * c);
            }
        }
        sums[0] += y * y; sums[1] += v * v; sums[2] += y * y * y * y;
    }
    state[0] = y; state[1] = v; state[2] = f;
}
