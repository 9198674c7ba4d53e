// Spring c y^5.
static Force quintic(int num, const double *p, double *memory, double from, double to, double v)
{
    return (Force){p[0] * pow(to, 5.0), 5.0 * p[0] * pow(to, 4.0), 0.0};
}
