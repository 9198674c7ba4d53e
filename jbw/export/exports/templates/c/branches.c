// x P(c x), the approach (1 - exp(-c x)) / c without 0/0.
static inline double approach(double c, double x)
{
    double a = c * x;
    return a == 0.0 ? x : -x * expm1(-a) / a;
}

// The way over which a stretch w relaxes to zero at the rate c, log(1 + c w) / c.
static inline double way_to_zero(double c, double w)
{
    double a = c * w;
    if (a <= -1.0)
        return INFINITY;
    return a == 0.0 ? w : w * log1p(a) / a;
}

// Bouc-Wen's force z after a monotone move dy: dz/dy = alpha - gamma sgn(dy) z - delta |z|.
static inline double bouc_wen_moved(const double *p, double z, double dy)
{
    double alpha = p[0], delta = p[1], gamma = p[2];
    double side = dy < 0.0 ? -1.0 : 1.0, length = fabs(dy), c;
    z *= side;
    if (z < 0.0) {
        double release = way_to_zero(gamma - delta, -z / alpha);
        if (length <= release) {
            c = gamma - delta;
            return side * (z + (alpha - c * z) * approach(c, length));
        }
        length -= release;
        z = 0.0;
    }
    c = gamma + delta;
    return side * (z + (alpha - c * z) * approach(c, length));
}

// Its slope there.
static inline double bouc_wen_slope(const double *p, double z, double dy)
{
    double side = dy < 0.0 ? -1.0 : 1.0;
    return p[0] - p[2] * side * z - p[1] * fabs(z);
}

// A virgin curve at x >= 0: force [N/kg] and slope [1/s^2].
typedef struct {
    double force, slope;
} Curve;

// Masing's rules remember the latest reversals, the latest one first; the oldest entry is where
// the virgin curve begins.
enum { REVERSALS = 10 };
typedef struct {
    double sense, count, force, y[REVERSALS], f[REVERSALS];
} Reversals;

static inline void turn_here(Reversals *m, double y)
{
    int full = m->count > REVERSALS - 0.5;
    // A full register keeps its two oldest and gives up the pair before them.
    int kept = full ? REVERSALS - 4 : REVERSALS - 1;
    if (full)
        for (int i = 0; i < 2; ++i) {
            m->y[kept + 1 + i] = m->y[REVERSALS - 2 + i];
            m->f[kept + 1 + i] = m->f[REVERSALS - 2 + i];
        }
    for (int i = kept; i > 0; --i) {
        m->y[i] = m->y[i - 1];
        m->f[i] = m->f[i - 1];
    }
    m->y[0] = y;
    m->f[0] = m->force;
    m->count += full ? -1.0 : 1.0;
}

// Where the present branch closes: at the reversal before its own, or at its own mirror image.
static inline double closure(const Reversals *m)
{
    return m->count > 2.5 ? m->y[1] : 2.0 * m->y[1] - m->y[0];
}

static inline void forget(Reversals *m, int num)
{
    for (int i = 0; i + num < REVERSALS; ++i) {
        m->y[i] = m->y[i + num];
        m->f[i] = m->f[i + num];
    }
    m->count -= num;
}

static inline Force masing(
    Curve (*virgin)(const double *, double), const double *p, double *memory, double from, double to)
{
    Reversals *m = (Reversals *)memory;
    double dy = to - from, rounding;
    if (m->sense * dy < 0.0 || (m->sense == 0.0 && dy != 0.0)) {
        turn_here(m, from);
        m->sense = dy < 0.0 ? -1.0 : 1.0;
    }
    while (m->count > 1.5) {
        rounding = 1e-14 * (fabs(to) + fabs(m->y[0]));
        if (m->sense * (to - closure(m)) < -rounding)
            break;
        forget(m, m->count > 2.5 ? 2 : 1);
    }
    double stretch = m->count > 1.5 ? 2.0 : 1.0;
    double distance = fmax(m->sense * (to - m->y[0]), 0.0);
    Curve curve = virgin(p, distance / stretch);
    if (m->count > 0.5)
        m->force = m->f[0] + m->sense * stretch * curve.force;
    return (Force){m->force, curve.slope, 0.0};
}
