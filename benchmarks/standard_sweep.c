/* Classical RK4 for the Bouc-Wen oscillator (nu = 1) under a first-order hold: the yardstick. */
#include <math.h>

static void rate(const double *p, double u, const double *x, double *dx) {
    const double c = 2 * p[1] * p[0], k = p[0] * p[0] - p[2];
    dx[0] = x[1];
    dx[1] = u - c * x[1] - k * x[0] - x[2];
    dx[2] = p[2] * x[1] - p[4] * fabs(x[1]) * x[2] - p[3] * x[1] * fabs(x[2]);
}

/* p = (omega_n, zeta, alpha, delta, gamma); m steps a sample; v at the samples. */
void rk4(const double *p, const double *u, long n, double fs, int m, double *v) {
    double x[3] = {0, 0, 0}, a[3], b[3], c[3], d[3], s[3];
    const double h = 1.0 / (fs * m);
    v[0] = 0;
    for (long i = 0; i + 1 < n; i++) {
        const double slope = (u[i + 1] - u[i]) / m;
        for (int j = 0; j < m; j++) {
            const double u0 = u[i] + slope * j;
            rate(p, u0, x, a);
            for (int q = 0; q < 3; q++) s[q] = x[q] + 0.5 * h * a[q];
            rate(p, u0 + 0.5 * slope, s, b);
            for (int q = 0; q < 3; q++) s[q] = x[q] + 0.5 * h * b[q];
            rate(p, u0 + 0.5 * slope, s, c);
            for (int q = 0; q < 3; q++) s[q] = x[q] + h * c[q];
            rate(p, u0 + slope, s, d);
            for (int q = 0; q < 3; q++) x[q] += h / 6 * (a[q] + 2 * b[q] + 2 * c[q] + d[q]);
        }
        v[i + 1] = x[1];
    }
}
