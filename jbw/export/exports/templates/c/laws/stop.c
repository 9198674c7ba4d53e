// Two-sided stop, of stiffness p[0] beyond p[1].
static Force stop(int num, const double *p, double *memory, double from, double to, double v)
{
    double beyond = fmax(fabs(to) - p[1], 0.0);
    return (Force){p[0] * copysign(beyond, to), beyond > 0.0 ? p[0] : 0.0, 0.0};
}
