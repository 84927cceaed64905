/* The equations of variation by their Taylor series, see variation.h and references/exact/variation.py. */
#include "variation.h"
#include "loops.h"
#include "march.h"

static inline void add_one(double *restrict out, double factor, const double *restrict x, Int n)
{
    for (Int j = 0; j < n; j++) out[j] += factor * x[j];
}

/* out += factor x matrix, (count, n). */
static inline void add_product(double *restrict out, double factor, const double *restrict x, const double *restrict matrix, Int count,
                               Int n)
{
    for (Int i = 0; i < count; i++)
        if (x[i] != 0.0) add_one(out, factor * x[i], matrix + i * n, n);
}

/* The reactions by which held contacts keep their places are added to `right`, (n,), and to force (m,). */
static void react(const Regime *r, double *right, const double *curve, double *force, double *opened)
{
    for (int pass = 0; pass < 2; pass++) { /* the second takes what rounding left: a body at rest stays at rest */
        for (Int x = 0; x < r->h; x++)
            opened[x] = dot(r->rows + r->held[x] * r->n, right, r->n) + curve[r->held[x]];
        for (Int y = 0; y < r->h; y++) {
            double more = -dot(r->inverse + y * r->h, opened, r->h);
            force[r->held[y]] += more;
            add_one(right, more, r->rows + r->held[y] * r->n, r->n);
        }
    }
}

/* Positions of the contacts, (1 + D, m), of one coefficient a (1 + D, n). */
HOT static void observe(const Regime *r, Int D, const double *a, const double *shift, double *u)
{
    Int n = r->n, m = r->m;
    for (Int d = 0; d <= D; d++)
        for (Int i = 0; i < m; i++) {
            u[d * m + i] = shift[d * m + i] + dot(r->rows + i * n, a + d * n, n);
            if (d > 0 && d <= r->P && r->rows_by) u[d * m + i] += dot(r->rows_by + ((d - 1) * m + i) * n, a, n);
        }
}

/* Coefficient k of u - g of contact i, or of its derivative d. */
static double gap(const Regime *r, Int d, Int i, Int k, const double *u)
{
    if (k > 0 || d > r->P) return u[d * r->m + i];
    return u[d * r->m + i] - (d == 0 ? r->stop[i] : r->stop_by[(d - 1) * r->m + i]);
}

/* Coefficient k + 2 (1 + D, n) of the motion and of its derivatives from a, coefficient k. scratch: (h + m,). */
HOT static void next_term(const Regime *r, Int D, Int k, const double *drive, const double *a, const double *u,
                      const double *shift, double *force, double *scratch)
{
    Int n = r->n, m = r->m, L = r->L, P = r->P, wide = (1 + D) * n, tall = (1 + D) * m;
    const double *rate = a + wide;
    double *new = (double *)rate + wide, one = k + 1.0, two = (k + 1.0) * (k + 2.0);
    for (Int d = 0; d <= D; d++) {
        double *right = new + d * n, *own = force + d * m;
        int by = d > 0 && d <= P; /* by a parameter */
        Int p = d - 1, square = p * n * n;
        for (Int j = 0; j < n; j++) right[j] = -r->w2[j] * a[d * n + j];
        for (Int j = 0; r->drag && j < n; j++) right[j] -= one * r->drag[j] * rate[d * n + j];
        if (r->damping) add_product(right, -one, rate + d * n, r->damping, n, n);
        if (d <= P) add_product(right, 1.0, drive + d * L, r->loads, L, n);
        if (by && r->loads_by) add_product(right, 1.0, drive, r->loads_by + p * L * n, L, n);
        if (by && r->stiffness_by) add_product(right, -1.0, a, r->stiffness_by + square, n, n);
        if (by && r->damping_by) add_product(right, -one, rate, r->damping_by + square, n, n);
        for (Int i = 0; i < m; i++) {
            own[i] = -(r->kappa[i] * gap(r, d, i, k, u) + r->c[i] * one * u[tall + d * m + i]);
            if (by) own[i] -= r->kappa_by[p * m + i] * gap(r, 0, i, k, u) + r->c_by[p * m + i] * one * u[tall + i];
        }
        add_product(right, 1.0, own, r->rows, m, n);
        if (by && r->rows_by) add_product(right, 1.0, force, r->rows_by + p * m * n, m, n);
        if (by && r->mass_by) add_product(right, -1.0, new, r->mass_by + square, n, n);
        if (!r->h) continue;
        double *curve = scratch + r->h;
        for (Int i = 0; i < m; i++) {
            curve[i] = two * shift[2 * tall + d * m + i];
            if (by && r->rows_by) curve[i] += dot(r->rows_by + (p * m + i) * n, new, n);
        }
        react(r, right, curve, own, scratch);
    }
    for (Int j = 0; j < wide; j++) new[j] /= two;
}

/* Modes and rates z (2 n) at `late` of a series whose coefficients are `wide` apart, by Horner's rule. */
HOT static void add_up(const double *a, Int K, Int wide, Int n, double late, double *restrict z)
{
    for (Int j = 0; j < 2 * n; j++) z[j] = 0.0;
    for (Int k = K; k >= 0; k--)
        for (Int j = 0; j < n; j++) {
            z[n + j] = z[n + j] * late + z[j];
            z[j] = z[j] * late + a[k * wide + j];
        }
}

/* Coefficients at one time: a (K + 1, 1 + D, n), u (K + 1, 1 + D, m), force (K - 1, 1 + D, m). */
static void expand(const Regime *r, Int D, Int K, const double *drive, const double *shift, const double *start, double *a,
                   double *u, double *force, double *scratch)
{
    Int n = r->n, wide = (1 + D) * n, tall = (1 + D) * r->m;
    for (Int d = 0; d <= D; d++)
        for (Int j = 0; j < n; j++) a[d * n + j] = start[2 * d * n + j], a[wide + d * n + j] = start[(2 * d + 1) * n + j];
    for (Int k = 0; k <= K; k++) {
        Int old = k - 2;
        if (old >= 0)
            next_term(r, D, old, drive + old * (1 + r->P) * r->L, a + old * wide, u + old * tall, shift + old * tall,
                      force + old * tall, scratch);
        observe(r, D, a + k * wide, shift + k * tall, u + k * tall);
    }
}

API Int vary(const Regime *r, Int S, Int D, Int K, const double *drive, const double *shift, const double *start,
             double *eta, double *u, double *force)
{
    Int wide = (1 + D) * r->n, tall = (1 + D) * r->m;
    double *scratch = malloc((size_t)(r->h + r->m + 1) * sizeof(double));
    if (!scratch) return NO_MEMORY;
    for (Int s = 0; s < S; s++)
        expand(r, D, K, drive + s * (K + 1) * (1 + r->P) * r->L, shift + s * (K + 1) * tall, start + s * 2 * wide,
               eta + s * (K + 1) * wide, u + s * (K + 1) * tall, force + s * (K - 1) * tall, scratch);
    free(scratch);
    return DONE;
}

API Int vary_later(const Regime *r, Int S, Int D, Int K, const double *drive, const double *shift, const double *start,
                   const Int *until, const double *late, double *later)
{
    Int n = r->n, wide = (1 + D) * n, tall = (1 + D) * r->m;
    double *a = malloc((size_t)((K + 1) * (wide + 2 * tall) + r->h + r->m + 1) * sizeof(double));
    if (!a) return NO_MEMORY;
    double *u = a + (K + 1) * wide, *force = u + (K + 1) * tall;
    for (Int s = 0, e = 0; s < S; s++) {
        if (e < until[s])
            expand(r, D, K, drive + s * (K + 1) * (1 + r->P) * r->L, shift + s * (K + 1) * tall, start + s * 2 * wide, a,
                   u, force, force + (K + 1) * tall);
        for (; e < until[s]; e++)
            for (Int d = 0; d <= D; d++) add_up(a + d * n, K, wide, n, late[e], later + (e * (1 + D) + d) * 2 * n);
    }
    free(a);
    return DONE;
}
