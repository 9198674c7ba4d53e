/* Motion of linear modes with Bouc-Wen joints, by the classical Runge-Kutta method.

   q_i'' + c_i q_i' + k_i q_i + sum_j h_ji (Z_j - alpha_j x_j) = b_i u,   x_j = sum_i h_ji q_i
   Z_j' = alpha_j x_j' - gamma_j |x_j'| Z_j - delta_j x_j' |Z_j|

   u is linear between its samples. The state is q, q', Z; sums are of y, y^2, y'^2 of the output y
   and of y cos, y sin at the phase step `turn` per sample. */

#include <math.h>

#define MOST 8

typedef struct {
  long modes, joints;
  const double *k, *c, *b, *h, *law;
} Structure;

static void rate(const Structure *s, const double *x, double u, double *dx)
{
  long n = s->modes;
  for (long i = 0; i < n; i++) {
    dx[i] = x[n + i];
    dx[n + i] = s->b[i] * u - s->c[i] * x[n + i] - s->k[i] * x[i];
  }
  for (long j = 0; j < s->joints; j++) {
    double place = 0, speed = 0, z = x[2 * n + j];
    double alpha = s->law[3 * j], delta = s->law[3 * j + 1], gamma = s->law[3 * j + 2];
    for (long i = 0; i < n; i++) {
      place += s->h[j * n + i] * x[i];
      speed += s->h[j * n + i] * x[n + i];
    }
    dx[2 * n + j] = alpha * speed - gamma * fabs(speed) * z - delta * speed * fabs(z);
    for (long i = 0; i < n; i++) dx[n + i] -= s->h[j * n + i] * (z - alpha * place);
  }
}

void motion(long modes, long joints, const double *k, const double *c, const double *b,
            const double *h, const double *law, const double *output, const double *u, long count,
            double dt, double turn, double phase, double *x, double *sums)
{
  Structure s = {modes, joints, k, c, b, h, law};
  long size = 2 * modes + joints;
  double k1[3 * MOST], k2[3 * MOST], k3[3 * MOST], k4[3 * MOST], at[3 * MOST];
  for (long t = 0; t < count; t++) {
    double middle = 0.5 * (u[t] + u[t + 1]), y = 0, v = 0;
    for (long i = 0; i < modes; i++) {
      y += output[i] * x[i];
      v += output[i] * x[modes + i];
    }
    sums[0] += y;
    sums[1] += y * y;
    sums[2] += v * v;
    sums[3] += y * cos(phase + turn * t);
    sums[4] += y * sin(phase + turn * t);
    rate(&s, x, u[t], k1);
    for (long i = 0; i < size; i++) at[i] = x[i] + 0.5 * dt * k1[i];
    rate(&s, at, middle, k2);
    for (long i = 0; i < size; i++) at[i] = x[i] + 0.5 * dt * k2[i];
    rate(&s, at, middle, k3);
    for (long i = 0; i < size; i++) at[i] = x[i] + dt * k3[i];
    rate(&s, at, u[t + 1], k4);
    for (long i = 0; i < size; i++) x[i] += dt / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
  }
}
