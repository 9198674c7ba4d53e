/* Classical RK4 for the Bouc-Wen oscillator (nu = 1): the yardstick of all benchmarks.
 * p = (omega_n, zeta, alpha, delta, gamma), the state is (y, v, z), from rest. */
#include <math.h>

#define WIDTH 16 /* parameter sets side by side in rk4_lanes */

static void rate(const double *p, double u, const double *x, double *dx) {
    const double c = 2 * p[1] * p[0], k = p[0] * p[0] - p[2];
    dx[0] = x[1];
    dx[1] = u - c * x[1] - k * x[0] - x[2];
    dx[2] = p[2] * x[1] - p[4] * fabs(x[1]) * x[2] - p[3] * x[1] * fabs(x[2]);
}

static void step(const double *p, double h, double u0, double um, double u1, double *x) {
    double a[3], b[3], c[3], d[3], s[3];
    rate(p, u0, x, a);
    for (int q = 0; q < 3; q++) s[q] = x[q] + 0.5 * h * a[q];
    rate(p, um, s, b);
    for (int q = 0; q < 3; q++) s[q] = x[q] + 0.5 * h * b[q];
    rate(p, um, s, c);
    for (int q = 0; q < 3; q++) s[q] = x[q] + h * c[q];
    rate(p, u1, s, d);
    for (int q = 0; q < 3; q++) x[q] += h / 6 * (a[q] + 2 * b[q] + 2 * c[q] + d[q]);
}

/* Velocity at the n samples of u, a polygon between them; m steps a sample. */
void rk4(const double *p, const double *u, long n, double fs, int m, double *v) {
    double x[3] = {0, 0, 0};
    const double h = 1.0 / (fs * m);
    v[0] = 0;
    for (long i = 0; i + 1 < n; i++) {
        const double slope = (u[i + 1] - u[i]) / m;
        for (int j = 0; j < m; j++) {
            const double u0 = u[i] + slope * j;
            step(p, h, u0, u0 + 0.5 * slope, u0 + slope, x);
        }
        v[i + 1] = x[1];
    }
}

/* Displacement under the tone u = amplitude cos(omega t). */
void rk4_tone(const double *p, double omega, double amplitude, long n, double fs, double *y) {
    double x[3] = {0, 0, 0}, u0 = amplitude;
    const double h = 1.0 / fs;
    for (long i = 0; i < n; i++) {
        y[i] = x[0];
        const double um = amplitude * cos(omega * (i + 0.5) * h);
        const double u1 = amplitude * cos(omega * (i + 1) * h);
        step(p, h, u0, um, u1, x);
        u0 = u1;
    }
}

static inline void rate_lanes(const double p[5][WIDTH], double u, double x[3][WIDTH],
                              double dx[3][WIDTH]) {
    for (int l = 0; l < WIDTH; l++) {
        const double c = 2 * p[1][l] * p[0][l], k = p[0][l] * p[0][l] - p[2][l];
        const double v = x[1][l], z = x[2][l];
        dx[0][l] = v;
        dx[1][l] = u - c * v - k * x[0][l] - z;
        dx[2][l] = p[2][l] * v - p[4][l] * fabs(v) * z - p[3][l] * v * fabs(z);
    }
}

static inline void stage(double x[3][WIDTH], double h, double dx[3][WIDTH], double s[3][WIDTH]) {
    for (int q = 0; q < 3; q++)
        for (int l = 0; l < WIDTH; l++) s[q][l] = x[q][l] + h * dx[q][l];
}

/* As rk4 for WIDTH parameter sets p[5][WIDTH] at once; v[n][WIDTH]. */
void rk4_lanes(const double p[5][WIDTH], const double *u, long n, double fs, int m,
               double v[][WIDTH]) {
    double x[3][WIDTH] = {0}, a[3][WIDTH], b[3][WIDTH], c[3][WIDTH], d[3][WIDTH], s[3][WIDTH];
    const double h = 1.0 / (fs * m);
    for (int l = 0; l < WIDTH; l++) v[0][l] = 0;
    for (long i = 0; i + 1 < n; i++) {
        const double slope = (u[i + 1] - u[i]) / m;
        for (int j = 0; j < m; j++) {
            const double u0 = u[i] + slope * j;
            rate_lanes(p, u0, x, a);
            stage(x, 0.5 * h, a, s);
            rate_lanes(p, u0 + 0.5 * slope, s, b);
            stage(x, 0.5 * h, b, s);
            rate_lanes(p, u0 + 0.5 * slope, s, c);
            stage(x, h, c, s);
            rate_lanes(p, u0 + slope, s, d);
            for (int q = 0; q < 3; q++)
                for (int l = 0; l < WIDTH; l++)
                    x[q][l] += h / 6 * (a[q][l] + 2 * b[q][l] + 2 * c[q][l] + d[q][l]);
        }
        for (int l = 0; l < WIDTH; l++) v[i + 1][l] = x[1][l];
    }
}
