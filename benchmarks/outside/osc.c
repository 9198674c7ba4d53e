/* Records of a joint made without jbw: RK4 of one mode with its joint, and of a second mode.

   y'' (1 + mu) + c_arm y' + k_arm y + 2 zeta w y' + (w^2 - K) y + f(y) + g(y') + F_joint = u

   Lengths, times and forces have the units of the caller. Elements that know no rate (Jenkins
   sliders, a Bouc-Wen element of nu = 1 behind a gap) are advanced exactly along each step's
   displacement; Bouc-Wen, Valanis and LuGre elements are states of the integration. */
#include <math.h>
#include <string.h>

enum {
  OMEGA, ZETA, ALPHA, DELTA, GAMMA, NU, GAP, GAP_ALPHA, GAP_DELTA, GAP_GAMMA,
  QUADRATIC, SQUARE, CUBIC, QUINTIC, STOP, STOP_AT, QUADRATIC_DAMPING, CUBIC_DAMPING,
  SIGMA_0, SIGMA_1, SIGMA_2, F_COULOMB, F_STATIC, V_STRIBECK,
  VALANIS_0, VALANIS_T, VALANIS_LAMBDA, VALANIS_KAPPA, KINETIC,
  DRIFT, MU, C_ARM, K_ARM, OMEGA_2, ZETA_2, GAIN_2
};
enum { NUM_STATES = 7, NUM_OUT = 6, MOST = 1024 };

typedef struct {
  const double *p, *k, *f; /* parameters, stiffness and largest force of each slider */
  int n;                   /* sliders */
  double stuck;            /* K */
  double force[MOST];      /* of each slider at the start of the step */
  int slides[MOST];        /* its direction, where it slides at its kinetic force */
  double z, s;             /* force and position of the element behind a gap */
} Joint;

static double within(double x, double a) { return x > a ? a : (x < -a ? -a : x); }

static double sliders(Joint *j, double d, int keep) {
  double sum = 0, kinetic = j->p[KINETIC];
  if (kinetic >= 1) {
    for (int i = 0; i < j->n; i++) {
      double x = within(j->force[i] + j->k[i] * d, j->f[i]);
      if (keep) j->force[i] = x;
      sum += x;
    }
    return sum;
  }
  for (int i = 0; i < j->n; i++) { /* a slider that slid sticks until its static force */
    double x;
    int way = 0;
    if (j->slides[i] && j->slides[i] * d >= 0) {
      way = j->slides[i];
      x = way * kinetic * j->f[i];
    } else {
      x = j->force[i] + j->k[i] * d;
      if (fabs(x) >= j->f[i]) {
        way = x > 0 ? 1 : -1;
        x = way * kinetic * j->f[i];
      }
    }
    if (keep) { j->force[i] = x; j->slides[i] = way; }
    sum += x;
  }
  return sum;
}

/* Z after a monotone move d of a Bouc-Wen element with nu = 1, exact on either side of Z = 0. */
static double duhem(const double *p, double z, double d) {
  double s = d > 0 ? 1 : -1, a = p[GAP_ALPHA];
  d = fabs(d);
  z *= s; /* as if it moved forward */
  if (z < 0) {
    double c = p[GAP_GAMMA] - p[GAP_DELTA]; /* dz/dd = a - c z */
    double to_zero = fabs(c) < 1e-300 ? -z / a : log1p(-c * z / a) / c;
    if (d < to_zero) {
      double e = fabs(c) < 1e-300 ? z + a * d : a / c + (z - a / c) * exp(-c * d);
      return s * e;
    }
    d -= to_zero;
    z = 0;
  }
  double c = p[GAP_GAMMA] + p[GAP_DELTA];
  return s * (fabs(c) < 1e-300 ? z + a * d : a / c + (z - a / c) * exp(-c * d));
}

static double behind_gap(Joint *j, double d, int keep) {
  const double *p = j->p;
  double z = j->z, s = j->s, b = p[GAP];
  if (p[GAP_ALPHA] == 0) return 0;
  if (d != 0) {
    double way = d > 0 ? 1 : -1, rest = fabs(d);
    if (way * z < 0) { /* unload to zero before the gap opens */
      double c = p[GAP_GAMMA] - p[GAP_DELTA], back = way * z;
      double to_zero = fabs(c) < 1e-300 ? -back / p[GAP_ALPHA] : log1p(-c * back / p[GAP_ALPHA]) / c;
      if (rest < to_zero) { z = duhem(p, z, d); rest = 0; }
      else { z = 0; rest -= to_zero; }
    }
    if (rest > 0 && z == 0 && way * s < b) {
      double used = fmin(rest, b - way * s);
      s += way * used;
      rest -= used;
    }
    if (rest > 0) { z = duhem(p, z, way * rest); s = way * b; }
  }
  if (keep) { j->z = z; j->s = s; }
  return z;
}

/* Rate of a Bouc-Wen force along displacement is p[ALPHA] - ...: here by time. */
static double bouc_wen(const double *p, double v, double z) {
  double size = fabs(z), power = p[NU] == 1 ? size : pow(size, p[NU]);
  double sign = z > 0 ? 1 : (z < 0 ? -1 : 0);
  return p[ALPHA] * v - p[GAMMA] * fabs(v) * sign * power - p[DELTA] * v * power;
}

static double valanis(const double *p, double v, double z) {
  if (p[VALANIS_0] == 0) return 0;
  double s = v > 0 ? 1 : -1, l = p[VALANIS_LAMBDA] * s * z;
  return v * ((p[VALANIS_0] - l) / (1 - p[VALANIS_KAPPA] * l / p[VALANIS_0]) - p[VALANIS_T]);
}

static double lugre(const double *p, double v, double w) {
  if (p[SIGMA_0] == 0) return 0;
  double r = v / p[V_STRIBECK], g = p[F_COULOMB] + (p[F_STATIC] - p[F_COULOMB]) * exp(-r * r);
  return v - p[SIGMA_0] * fabs(v) * w / g;
}

/* Force of everything but the linear spring's omega^2 y that is not stuck: joint, springs, dampers.
   x: y, v, z (Bouc-Wen), z (Valanis), w (LuGre), y2, v2; y0: displacement at the step's start. */
static double force_of(Joint *j, const double *x, double y0, double *d) {
  const double *p = j->p;
  double y = x[0], v = x[1], past = fabs(y) - p[STOP_AT];
  d[2] = bouc_wen(p, v, x[2]);
  d[3] = valanis(p, v, x[3]);
  d[4] = lugre(p, v, x[4]);
  double f = x[2] + x[3] + p[VALANIS_T] * y + p[SIGMA_0] * x[4] + p[SIGMA_1] * d[4] + p[SIGMA_2] * v;
  f += sliders(j, y - y0, 0) + behind_gap(j, y - y0, 0);
  f += y * (p[QUADRATIC] * fabs(y) + p[SQUARE] * y + y * y * (p[CUBIC] + p[QUINTIC] * y * y));
  if (p[STOP] != 0 && past > 0) f += p[STOP] * (y > 0 ? past : -past);
  return f + v * (p[QUADRATIC_DAMPING] * fabs(v) + p[CUBIC_DAMPING] * v * v);
}

static void rate(Joint *j, double t, double u, const double *x, double y0, double *d) {
  const double *p = j->p;
  double w = p[OMEGA] * (1 + p[DRIFT] * t);
  double f = force_of(j, x, y0, d) + (w * w - j->stuck + p[K_ARM]) * x[0];
  d[0] = x[1];
  d[1] = (u - f - (2 * p[ZETA] * w + p[C_ARM]) * x[1]) / (1 + p[MU]);
  d[5] = x[6];
  d[6] = p[GAIN_2] * u - 2 * p[ZETA_2] * p[OMEGA_2] * x[6] - p[OMEGA_2] * p[OMEGA_2] * x[5];
}

static void begin(Joint *j, const double *p, const double *k, const double *f, int n) {
  memset(j, 0, sizeof *j);
  j->p = p; j->k = k; j->f = f; j->n = n;
  j->stuck = p[ALPHA] + p[VALANIS_0] + p[SIGMA_0];
  for (int i = 0; i < n; i++) j->stuck += k[i];
}

static void keep(Joint *j, double d) { sliders(j, d, 1); behind_gap(j, d, 1); }

/* States of the joint after it was pulled slowly from rest to x[0]. */
static void pull(Joint *j, double *x) {
  double y = x[0], d[NUM_STATES], a[5], b[5], c[5], s[NUM_STATES] = {0};
  int m = 2000;
  s[1] = y / m; /* a step of unit time each */
  for (int i = 0; i < m; i++) {
    double *z = s;
    force_of(j, z, z[0], d); for (int q = 2; q < 5; q++) a[q] = d[q];
    double h[NUM_STATES]; memcpy(h, s, sizeof h);
    for (int q = 2; q < 5; q++) h[q] = s[q] + a[q] / 2;
    force_of(j, h, h[0], d); for (int q = 2; q < 5; q++) b[q] = d[q];
    for (int q = 2; q < 5; q++) h[q] = s[q] + b[q] / 2;
    force_of(j, h, h[0], d); for (int q = 2; q < 5; q++) c[q] = d[q];
    for (int q = 2; q < 5; q++) h[q] = s[q] + c[q];
    force_of(j, h, h[0], d);
    for (int q = 2; q < 5; q++) s[q] += (a[q] + 2 * b[q] + 2 * c[q] + d[q]) / 6;
    keep(j, y / m);
    s[0] += y / m;
  }
  for (int q = 2; q < 5; q++) x[q] = s[q];
}

/* n samples from the state x under u, given at every half step: y, v, a, y2, v2, a2 a sample.
   Returns 1 where the motion is not finite. */
int march(const double *u, long n, int sub, double h, const double *p, const double *k,
          const double *f, int num, const double *start, int pulled, double *out) {
  Joint j;
  begin(&j, p, k, f, num);
  double x[NUM_STATES], a[NUM_STATES], b[NUM_STATES], c[NUM_STATES], d[NUM_STATES], w[NUM_STATES];
  memcpy(x, start, sizeof x);
  if (pulled) pull(&j, x);
  for (long i = 0; i <= (n - 1) * sub; i++) {
    double t = i * h;
    rate(&j, t, u[2 * i], x, x[0], a);
    if (i % sub == 0) {
      double *o = out + NUM_OUT * (i / sub);
      o[0] = x[0]; o[1] = x[1]; o[2] = a[1]; o[3] = x[5]; o[4] = x[6]; o[5] = a[6];
      if (!isfinite(x[0])) return 1;
    }
    if (i == (n - 1) * sub) break;
    for (int q = 0; q < NUM_STATES; q++) w[q] = x[q] + h / 2 * a[q];
    rate(&j, t + h / 2, u[2 * i + 1], w, x[0], b);
    for (int q = 0; q < NUM_STATES; q++) w[q] = x[q] + h / 2 * b[q];
    rate(&j, t + h / 2, u[2 * i + 1], w, x[0], c);
    for (int q = 0; q < NUM_STATES; q++) w[q] = x[q] + h * c[q];
    rate(&j, t + h, u[2 * i + 2], w, x[0], d);
    double y0 = x[0];
    for (int q = 0; q < NUM_STATES; q++) x[q] += h / 6 * (a[q] + 2 * b[q] + 2 * c[q] + d[q]);
    keep(&j, x[0] - y0);
  }
  return 0;
}

/* Restoring force along a displacement and its velocity, both given at every half step. */
int along(const double *y, const double *v, long n, int sub, double h, const double *p,
          const double *k, const double *f, int num, double *out) {
  Joint j;
  begin(&j, p, k, f, num);
  double x[NUM_STATES] = {0}, a[NUM_STATES], b[NUM_STATES], c[NUM_STATES], d[NUM_STATES];
  double elastic = p[OMEGA] * p[OMEGA] - j.stuck, w[NUM_STATES];
  for (long i = 0; i <= (n - 1) * sub; i++) {
    x[0] = y[2 * i]; x[1] = v[2 * i];
    double force = force_of(&j, x, x[0], a);
    if (i % sub == 0) {
      out[i / sub] = force + elastic * x[0] + 2 * p[ZETA] * p[OMEGA] * x[1];
      if (!isfinite(force)) return 1;
    }
    if (i == (n - 1) * sub) break;
    memcpy(w, x, sizeof w);
    w[0] = y[2 * i + 1]; w[1] = v[2 * i + 1];
    for (int q = 2; q < 5; q++) w[q] = x[q] + h / 2 * a[q];
    force_of(&j, w, y[2 * i], b);
    for (int q = 2; q < 5; q++) w[q] = x[q] + h / 2 * b[q];
    force_of(&j, w, y[2 * i], c);
    w[0] = y[2 * i + 2]; w[1] = v[2 * i + 2];
    for (int q = 2; q < 5; q++) w[q] = x[q] + h * c[q];
    force_of(&j, w, y[2 * i], d);
    for (int q = 2; q < 5; q++) x[q] += h / 6 * (a[q] + 2 * b[q] + 2 * c[q] + d[q]);
    keep(&j, y[2 * i + 2] - y[2 * i]);
  }
  return 0;
}
