// Masing's law of the exponential virgin curve.
static Curve masing_exponential_virgin(const double *p, double x)
{
    return (Curve){p[0] * approach(p[1], x), p[0] * exp(-p[1] * x)};
}

static Force masing_exponential(
    int num, const double *p, double *memory, double from, double to, double v)
{
    return masing(masing_exponential_virgin, p, memory, from, to);
}
