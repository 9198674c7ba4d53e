// Sliders in parallel; remembers their stretches. Slips but the first are ratios of the one before.
static Force jenkins(int num, const double *p, double *memory, double from, double to, double v)
{
    Force total = {0.0, 0.0, 0.0};
    double slip = 1.0, dy = to - from;
    for (int i = 0; 2 * i < num; ++i) {
        double alpha = p[2 * i], stretch = memory[i] + dy;
        slip *= p[2 * i + 1];
        if (fabs(stretch) < slip)
            total.by_y += alpha;
        else
            stretch = copysign(slip, stretch);
        memory[i] = stretch;
        total.force += alpha * stretch;
    }
    return total;
}
