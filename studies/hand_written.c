/* HHT-alpha in modal coordinates with closed-form contact at one place: `by_hand` of hand_written.py in C.

   n modes: q, v, a, net (in: at the start), squares omega^2, row, and the load sine sin(wt) + cosine cos(wt);
   work: 2 n numbers. tip: (steps + 1), the first given. */
#include <math.h>

void march(long n, long steps, double *q, double *v, double *a, double *net, const double *squares,
           const double *row, const double *sine, const double *cosine, double frequency, double alpha,
           double dt, double kappa, double g1, double g2, double *work, double *tip)
{
    const double beta = (1 - alpha) * (1 - alpha) / 4, gamma = 0.5 - alpha;
    double *inverse = work, *push = work + n, s = 0.0;
    for (long j = 0; j < n; j++) {
        inverse[j] = 1.0 / (1.0 + (1.0 + alpha) * beta * dt * dt * squares[j]);
        push[j] = (1.0 + alpha) * inverse[j] * row[j];
        s += beta * dt * dt * push[j] * row[j];
    }
    const double stiff = kappa / (1.0 + kappa * s);
    for (long k = 1; k <= steps; k++) {
        const double S = sin(frequency * k * dt), C = cos(frequency * k * dt);
        double r = 0.0, force = 0.0;
        for (long j = 0; j < n; j++) {
            const double ahead = q[j] + dt * v[j] + dt * dt * (0.5 - beta) * a[j];
            v[j] += dt * (1.0 - gamma) * a[j];
            a[j] = inverse[j] * ((1.0 + alpha) * (sine[j] * S + cosine[j] * C - squares[j] * ahead) - alpha * net[j]);
            q[j] = ahead + dt * dt * beta * a[j];
            r += row[j] * q[j];
        }
        if (r > g2 || r < g1) {
            force = stiff * ((r > g2 ? g2 : g1) - r);
            for (long j = 0; j < n; j++) {
                a[j] += push[j] * force;
                q[j] += dt * dt * beta * push[j] * force;
            }
            r += s * force;
        }
        for (long j = 0; j < n; j++) {
            v[j] += dt * gamma * a[j];
            net[j] = sine[j] * S + cosine[j] * C - squares[j] * q[j] + force * row[j];
        }
        tip[k] = r;
    }
}
