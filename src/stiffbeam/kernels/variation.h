/* Taylor series of a motion in its free modes and of its derivatives, see references/exact/variation.py.
 *
 * Sizes: n modes, m contacts, h of them held by rigid stops, L functions of time, P parameters, D >= P derivatives or 0,
 * S times, K + 1 coefficients. The motion is number 0, its derivatives are 1 to D, those by the parameters first.
 */
#ifndef STIFFBEAM_VARIATION_H
#define STIFFBEAM_VARIATION_H

#include "law.h"

/* A regime, with the derivatives of its numbers by the parameters; NULL for a matrix that does not change. */
typedef struct {
    Int n, m, h, L, P;
    const double *w2, *drag, *damping;             /* (n,), (n,), or (n, n) transposed in place of `drag`; NULL for none */
    const double *rows, *loads;                    /* (m, n), (L, n) */
    const double *kappa, *c, *stop;                /* (m,) of pressed contacts; else 0 */
    const double *inverse;                         /* (h, h) of the held rows rows^T */
    const double *mass_by, *stiffness_by, *damping_by, *rows_by; /* (P, n, n), damping transposed, and (P, m, n) */
    const double *loads_by, *kappa_by, *c_by, *stop_by;          /* (P, L, n), (P, m) each */
    const Int *held;                               /* (h,) */
} Regime;

/* drive (S, K + 1, 1 + P, L): functions of time and their derivatives. shift (S, K + 1, 1 + D, m): offsets of the
 * contacts. start (S, 1 + D, 2 n): modes and their rates. Coefficients: eta (S, K + 1, 1 + D, n),
 * u (S, K + 1, 1 + D, m) positions, force (S, K - 1, 1 + D, m). */
API Int vary(const Regime *r, Int S, Int D, Int K, const double *drive, const double *shift, const double *start,
             double *eta, double *u, double *force);

/* The sums of these series in place of the coefficients: later (E, 1 + D, 2 n), modes and rates. Those number
 * until[s - 1] to until[s] - 1 are at `late` (E,) behind the time s; until (S,). */
API Int vary_later(const Regime *r, Int S, Int D, Int K, const double *drive, const double *shift, const double *start,
                   const Int *until, const double *late, double *later);

#endif
