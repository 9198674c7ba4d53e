// Spring c y|y|.
static Force quadratic(int num, const double *p, double *memory, double from, double to, double v)
{
    return (Force){p[0] * to * fabs(to), 2.0 * p[0] * fabs(to), 0.0};
}
