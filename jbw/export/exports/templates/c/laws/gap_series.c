// Bouc-Wen's law behind a gap; remembers its force z and the place in the gap.
static Force gap_series(int num, const double *p, double *memory, double from, double to, double v)
{
    double alpha = p[0], delta = p[1], gamma = p[2], gap = p[3];
    double z = memory[0], place = memory[1], dy = to - from;
    double side = dy < 0.0 ? -1.0 : 1.0, left = fabs(dy);
    if (side * z < 0.0) {
        double release = way_to_zero(gamma - delta, fabs(z) / alpha);
        double unloaded = left > release ? 0.0 : bouc_wen_moved(p, z, dy);
        z = z * unloaded < 0.0 ? 0.0 : unloaded;
        left = fmax(left - release, 0.0);
    }
    if (side * z <= 0.0) {
        double travel = fmax(gap - side * place, 0.0);
        place = left > travel ? side * gap : place + side * left;
        left = fmax(left - travel, 0.0);
    }
    if (left > 0.0)
        z = bouc_wen_moved(p, z, side * left);
    memory[0] = z;
    memory[1] = place;
    int touches = z != 0.0 || side * place >= gap;
    return (Force){z, touches ? bouc_wen_slope(p, z, dy) : 0.0, 0.0};
}
