/* HHT-alpha in modal coordinates with closed-form contact at one place: `numba_loop` of hand_written.py in C.

   steps, and n modes unless -DMODES fixes their number, so that the loops unroll; tables: (8, n), a row for each name
   below; state: (3, n), q, dt q', dt^2 q'', in and out. tip: (steps + 1,), the first is given. */
#include <math.h>

#ifdef MODES
#define SIZE MODES
#else
#define SIZE n
#endif

void march(long n, long steps, const double *restrict tables, double *restrict state, double frequency, double dt,
           double beta, double gamma, double stiff, double compliance, double g1, double g2, double *restrict tip)
{
    double *restrict q = state, *restrict v = state + SIZE, *restrict a = state + 2 * SIZE;
    const double *restrict of_q = tables, *restrict of_v = of_q + SIZE, *restrict of_a = of_v + SIZE;
    const double *restrict of_sine = of_a + SIZE, *restrict of_cosine = of_sine + SIZE;
    const double *restrict of_force = of_cosine + SIZE, *restrict push = of_force + SIZE, *restrict row = push + SIZE;
    const double turn_sine = sin(frequency * dt), turn_cosine = cos(frequency * dt);
    double sine = 0.0, cosine = 1.0, force = 0.0;
    for (long k = 1; k <= steps; k++) {
        if (k % 64) {
            const double next = sine * turn_cosine + cosine * turn_sine;
            cosine = cosine * turn_cosine - sine * turn_sine;
            sine = next;
        } else {
            sine = sin(frequency * k * dt);
            cosine = cos(frequency * k * dt);
        }
        double r = 0.0;
        for (long j = 0; j < SIZE; j++) {
            const double next = of_q[j] * q[j] + of_v[j] * v[j] + of_a[j] * a[j] + of_sine[j] * sine
                                + of_cosine[j] * cosine + of_force[j] * force;
            q[j] += v[j] + (0.5 - beta) * a[j] + beta * next;
            v[j] += (1.0 - gamma) * a[j] + gamma * next;
            a[j] = next;
            r += row[j] * q[j];
        }
        force = 0.0;
        if (r > g2 || r < g1) {
            force = stiff * ((r > g2 ? g2 : g1) - r);
            for (long j = 0; j < SIZE; j++) {
                a[j] += force * push[j];
                v[j] += gamma * force * push[j];
                q[j] += beta * force * push[j];
            }
            r += compliance * force;
        }
        tip[k] = r;
    }
}
