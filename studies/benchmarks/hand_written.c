/* HHT-alpha in modal coordinates with closed-form contact at one place, by hand.

   steps, and n modes unless -DMODES fixes their number, so that the loops unroll; tables: (8, n), a row for each name
   below; state: (3, n), q, dt q', dt^2 q'', in and out. tip: (steps + 1,), the first is given. With -DOUTPUTS so are
   the tip's velocity, the force and the time; speed: what a force adds to dt times that velocity. With -DLEDGER so is
   the energy balance of an undamped motion; modal: (3, n), omega^2 and the load's sine and cosine parts; balance:
   (steps + 1, 7), energies of motion, bending and stop, input, loss, loss in contact, loss without. */
#include <math.h>

#ifdef MODES
#define SIZE MODES
#else
#define SIZE n
#endif

void march(long n, long steps, const double *restrict tables, double *restrict state, double frequency, double dt,
           double beta, double gamma, double stiff, double compliance, double g1, double g2, double *restrict tip
#ifdef OUTPUTS
           , double speed, double *restrict velocity, double *restrict sigma, double *restrict time
#endif
#ifdef LEDGER
           , const double *restrict modal, double kappa, double *restrict balance
#endif
           )
{
    double *restrict q = state, *restrict v = state + SIZE, *restrict a = state + 2 * SIZE;
    const double *restrict of_q = tables, *restrict of_v = of_q + SIZE, *restrict of_a = of_v + SIZE;
    const double *restrict of_sine = of_a + SIZE, *restrict of_cosine = of_sine + SIZE;
    const double *restrict of_force = of_cosine + SIZE, *restrict push = of_force + SIZE, *restrict row = push + SIZE;
    const double turn_sine = sin(frequency * dt), turn_cosine = cos(frequency * dt);
    double sine = 0.0, cosine = 1.0, force = 0.0;
#ifdef LEDGER
    const double *restrict squares = modal, *restrict by_sine = modal + SIZE, *restrict by_cosine = by_sine + SIZE;
    double sine_before = 0.0, cosine_before = 1.0, pull_sine = 0.0, pull_cosine = 0.0;
    for (long j = 0; j < SIZE; j++) {
        pull_sine += by_sine[j] * q[j];
        pull_cosine += by_cosine[j] * q[j];
    }
#endif
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
#ifdef OUTPUTS
        double w = 0.0;
#endif
        for (long j = 0; j < SIZE; j++) {
            const double next = of_q[j] * q[j] + of_v[j] * v[j] + of_a[j] * a[j] + of_sine[j] * sine
                                + of_cosine[j] * cosine + of_force[j] * force;
            q[j] += v[j] + (0.5 - beta) * a[j] + beta * next;
            v[j] += (1.0 - gamma) * a[j] + gamma * next;
            a[j] = next;
            r += row[j] * q[j];
#ifdef OUTPUTS
            w += row[j] * v[j];
#endif
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
#ifdef LEDGER
        double motion = 0.0, bending = 0.0, on_sine = 0.0, on_cosine = 0.0;
        for (long j = 0; j < SIZE; j++) {
            motion += v[j] * v[j];
            bending += squares[j] * q[j] * q[j];
            on_sine += by_sine[j] * q[j];
            on_cosine += by_cosine[j] * q[j];
        }
        const double *before = balance + 7 * (k - 1);
        double *now = balance + 7 * k;
        const double depth = r > g2 ? r - g2 : (r < g1 ? r - g1 : 0.0);
        const double input = 0.5 * (sine + sine_before) * (on_sine - pull_sine)
                             + 0.5 * (cosine + cosine_before) * (on_cosine - pull_cosine);
        now[0] = 0.5 * motion / (dt * dt);
        now[1] = 0.5 * bending;
        now[2] = 0.5 * kappa * depth * depth;
        const double loss = before[0] + before[1] + before[2] - now[0] - now[1] - now[2] + input;
        const int contact = before[2] > 0.0 || now[2] > 0.0;
        now[3] = before[3] + input;
        now[4] = before[4] + loss;
        now[5] = before[5] + (contact ? loss : 0.0);
        now[6] = before[6] + (contact ? 0.0 : loss);
        sine_before = sine, cosine_before = cosine, pull_sine = on_sine, pull_cosine = on_cosine;
#endif
#ifdef OUTPUTS
        velocity[k] = (w + speed * force) / dt;
        sigma[k] = force;
        time[k] = k * dt;
#endif
    }
}
