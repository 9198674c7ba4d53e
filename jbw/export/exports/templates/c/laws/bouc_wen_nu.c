// Bouc-Wen's law of any exponent; remembers the stretch w = z / alpha. The way to a stretch,
// the integral of 1 / (1 - c |t / 1 mm|^nu) from 0 to w, is by Gauss and Legendre in t = w s^m;
// near the limit of the stretch the pole z / (nu (1 - z)), z = t / limit, is taken out and known.
enum { NU_NODES = {{ legendre | length }} };
static const double NU_NODE[NU_NODES] = { {{- legendre | map("first") | map("number") | join(", ") -}} };
static const double NU_WEIGHT[NU_NODES] = { {{- legendre | map("last") | map("number") | join(", ") -}} };

typedef struct {
    double nu, weight[NU_NODES], place[NU_NODES], log_place[NU_NODES];
} Ways;

static Ways ways_of(double nu)
{
    Ways ways = {.nu = nu};
    double m = ceil(3.0 / nu);
    for (int i = 0; i < NU_NODES; ++i) {
        ways.weight[i] = NU_WEIGHT[i] * m * pow(NU_NODE[i], m - 1.0);
        ways.place[i] = pow(NU_NODE[i], m);
        ways.log_place[i] = m * log(NU_NODE[i]);
    }
    return ways;
}

static double lost_to(const Ways *ways, double c, double w)
{
    return c * pow(w / 1e-3, ways->nu);
}

static double limit_of(const Ways *ways, double c)
{
    return c > 0.0 ? 1e-3 * pow(1.0 / c, 1.0 / ways->nu) : INFINITY;
}

static double way_to(const Ways *ways, double c, double w)
{
    double nu = ways->nu, limit = limit_of(ways, c), sum = 0.0;
    if (w <= 0.5 * limit) {
        for (int i = 0; i < NU_NODES; ++i) {
            double lost = lost_to(ways, c, w * ways->place[i]);
            sum += ways->weight[i] * lost / (1.0 - lost);
        }
        return w + w * sum;
    }
    double x = w / limit, gap = fmax(1.0 - x, 1e-300);
    for (int i = 0; i < NU_NODES; ++i) {
        double log_z = log1p(-gap) + ways->log_place[i];
        double pole = x * ways->place[i] / nu / -expm1(log_z);
        sum += ways->weight[i] * (exp(nu * log_z) / -expm1(nu * log_z) - pole);
    }
    return w + w * (sum + (-log(gap) - x) / (nu * x));
}

// The stretch that lies so far along the way: by halving, and one step of Newton's.
static double stretch_at(const Ways *ways, double c, double way)
{
    double limit = limit_of(ways, c);
    double low = 0.0, high = fmin(16.0 * way, limit * (1.0 - 1e-15)), w;
    for (int i = 0; i < 60; ++i) {
        w = 0.5 * (low + high);
        if (way_to(ways, c, w) > way)
            high = w;
        else
            low = w;
    }
    w = 0.5 * (low + high);
    return w - (way_to(ways, c, w) - way) * (1.0 - lost_to(ways, c, w));
}

static Force bouc_wen_nu(int num, const double *p, double *memory, double from, double to, double v)
{
    double alpha = p[0], less = p[1] - p[2], more = p[1] + p[2];
    double w = memory[0], dy = to - from, side = dy < 0.0 ? -1.0 : 1.0, left = fabs(dy);
    Ways ways = ways_of(p[3]);
    if (dy != 0.0) {
        int against = side * w < 0.0;
        double begun = way_to(&ways, against ? less : more, fabs(w));
        if (against && left < begun)
            w = -side * stretch_at(&ways, less, begun - left);
        else
            w = side * stretch_at(&ways, more, against ? left - begun : begun + left);
    }
    memory[0] = w;
    double lost = lost_to(&ways, side * w < 0.0 ? less : more, fabs(w));
    return (Force){alpha * w, alpha * (1.0 - lost), 0.0};
}
