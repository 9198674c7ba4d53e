// Damper c v^3.
static Force cubic_damping(int num, const double *p, double *memory, double from, double to, double v)
{
    return (Force){p[0] * v * v * v, 0.0, 3.0 * p[0] * v * v};
}
