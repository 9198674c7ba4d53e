// Damper c v|v|.
static Force quadratic_damping(int num, const double *p, double *memory, double from, double to, double v)
{
    return (Force){p[0] * v * fabs(v), 0.0, 2.0 * p[0] * fabs(v)};
}
