// Bouc-Wen's law with nu = 1; remembers its force z.
static Force bouc_wen(int num, const double *p, double *memory, double from, double to, double v)
{
    memory[0] = bouc_wen_moved(p, memory[0], to - from);
    return (Force){memory[0], bouc_wen_slope(p, memory[0], to - from), 0.0};
}
