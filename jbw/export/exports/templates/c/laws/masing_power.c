// Masing's law of stiffness lost by a power of the amplitude; the loss is stated at 1 mm.
static Curve masing_power_virgin(const double *p, double x)
{
    double lost = p[0] * pow(x / 1e-3, p[1]);
    return (Curve){-lost * x, -(1.0 + p[1]) * lost};
}

static Force masing_power(int num, const double *p, double *memory, double from, double to, double v)
{
    return masing(masing_power_virgin, p, memory, from, to);
}
