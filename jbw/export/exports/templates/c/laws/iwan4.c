// Iwan's sliders by Segalman's four parameters; the loss of stiffness is stated at 1 mm.
static Curve iwan4_virgin(const double *p, double x)
{
    double own = p[0], loss = p[1], q = 1.0 + p[2], beta = p[3];
    double secant = own / ((1.0 + beta) * (1.0 + q));
    double macroslip = 1e-3 * pow(secant / loss, 1.0 / q);
    if (x >= macroslip)
        return (Curve){(own - secant) * macroslip, 0.0};
    double lost = secant * pow(x / macroslip, q);
    return (Curve){(own - lost) * x, own - (1.0 + q) * lost};
}

static Force iwan4(int num, const double *p, double *memory, double from, double to, double v)
{
    return masing(iwan4_virgin, p, memory, from, to);
}
