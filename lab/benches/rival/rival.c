/* The boundary walks of a sweep, hit by hit in scalar double, as somebody writes them who needs nothing else: the rival
 * of the simulator's processor time. Operations and their order are those of the simulator's f64 arithmetic, so that
 * both find the same boundaries; compile it with -ffp-contract=off for that.
 *
 * A walk a line on stdin: resolution, phi (4, by rows), gamma (2), rest position, start position, surface, stiffness and
 * damping (full scales per count, per count and sample, of one N/m and one N s/m), push (full scales), full scale (N),
 * RMS limit (counts), b0, a1, a2. Their boundaries on stdout: number of the walk, B, K; at last the hits. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>

enum { SETTLE = 40000, WINDOW = 20000, PERIOD = 10, LATENCY = 10, CHECK = 256 };

/* Grid of the walk: K and B from their starts in their steps. */
static const double K_START = 2000, K_STEP = 2000, K_MAX = 1e7, B_START = 10, B_STEP = 10, B_MAX = 4000;

struct device {
  double resolution, xx, xv, vx, vv, gx, gv, rest, start, surface, stiffness, damping, push, full_scale, limit;
  double b0, a1, a2;
};

static long hits;

/* n squares - sum^2 of n samples reaches the limit's. */
static int reaches(int64_t n, int64_t sum, int64_t squares, double limit, int64_t of) {
  double scatter = (double)((__int128)n * squares - (__int128)sum * sum);
  return scatter * (double)of >= limit * limit * (double)of * (double)of * (double)n;
}

/* Whether the wall is stable. */
static int hit(const struct device *d, double k, double b) {
  const double stiffness = k * d->stiffness, damping = b * d->damping;
  double x = d->start - d->rest, v = 0, x1 = 0, x2 = 0, y1 = 0, y2 = 0;
  double force = 0, next = 0, last = floor(d->start / d->resolution), origin = 0;
  int64_t sum = 0, squares = 0, contact = 0;
  hits++;
  for (int n = 0; n < SETTLE + WINDOW; n++) {
    double count = floor((x + d->rest) / d->resolution);
    double moved = count - last;
    last = count;
    double y = d->b0 * (moved + 2.0 * x1 + x2) - d->a1 * y1 - d->a2 * y2;
    if (fabs(y) < 1e-30) y = 0;
    x2 = x1, x1 = moved, y2 = y1, y1 = y;
    if (n % PERIOD == 0) {
      force = next; /* one output of latency */
      double depth = count - d->surface, wall = 0;
      if (depth > 0) {
        wall = stiffness * depth + damping * y;
        if (wall < 0) wall = 0;
      }
      double wanted = d->push - wall;
      next = (wanted > 1 ? 1 : wanted < -1 ? -1 : wanted) * d->full_scale;
    }
    double free_x = d->xx * x + d->xv * v, free_v = d->vx * x + d->vv * v;
    x = free_x + d->gx * force, v = free_v + d->gv * force;
    if (n >= SETTLE) {
      if (n == SETTLE) origin = count;
      int64_t away = (int64_t)(count - origin);
      sum += away, squares += away * away, contact += count > d->surface;
      if ((n + 1) % CHECK == 0 && contact && reaches(n + 1 - SETTLE, sum, squares, d->limit, WINDOW)) return 0;
    }
  }
  return !reaches(WINDOW, sum, squares, d->limit, WINDOW);
}

static void walk(int number, const struct device *d) {
  double k = K_START, b = B_START;
  if (!hit(d, k, b)) return;
  int stable = 1;
  for (;;) {
    if (stable) {
      while (k + K_STEP <= K_MAX && hit(d, k + K_STEP, b)) k += K_STEP;
    } else {
      do {
        k -= K_STEP;
        if (k <= 0) return;
      } while (!hit(d, k, b));
    }
    printf("%d %g %g\n", number, b, k);
    b += B_STEP;
    if (b > B_MAX) return;
    stable = hit(d, k, b);
  }
}

int main(void) {
  struct device d;
  for (int number = 0; scanf("%lf%lf%lf%lf%lf%lf%lf%lf%lf%lf%lf%lf%lf%lf%lf%lf%lf%lf", &d.resolution, &d.xx, &d.xv, &d.vx,
                             &d.vv, &d.gx, &d.gv, &d.rest, &d.start, &d.surface, &d.stiffness, &d.damping, &d.push,
                             &d.full_scale, &d.limit, &d.b0, &d.a1, &d.a2) == 18;
       number++)
    walk(number, &d);
  printf("hits %ld\n", hits);
  return 0;
}
