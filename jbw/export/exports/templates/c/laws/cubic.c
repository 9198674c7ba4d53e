// Spring c y^3.
static Force cubic(int num, const double *p, double *memory, double from, double to, double v)
{
    return (Force){p[0] * to * to * to, 3.0 * p[0] * to * to, 0.0};
}
