/* Exact motion of M q'' + C q' + K q = f(t) + sum_i row_i^T F_i, event by event, in the modes of the free system.
 *
 * FLIGHT  No contact is pressed or held, or a single spring is: every mode is a closed form, and so is what a contact
 *         sees. A gap is searched by leaps: its slow terms as a Taylor polynomial, its fast ones bounded by their
 *         amplitudes. Under records (piecewise cubic in time) a flight goes from sample to sample. Modes that a drive
 *         meets in resonance, and critically damped ones, are Taylor polynomials too, which bounds the flight's length.
 * SERIES  All else: the Taylor series of the modes with the contact forces as feedback or as multipliers,
 *             a[k+2] = (f[k] + sum_i row_i lam_i[k] - (k+1) D a[k+1] - w^2 a[k]) / ((k+1)(k+2)).
 *
 * Arguments and shapes: exact.h. Nothing here checks them: exact.py does. No global state; the work memory of a call is
 * one block (`layout`). Sums that may be taken in any order say so (omp simd): no -ffast-math, which would also drop NaN,
 * infinities (a missing stop) and the compensated sums of `advance`.
 */
#include "exact.h"
#include "loops.h"
#include "node.h"
#include "polynomial.h"

#define ROOM 24      /* terms of the polynomial part of a flight */
#define RADIANS 2.0  /* of the fastest motion in a step of series */
#define CHATTER 1e-6 /* radians of the fastest motion in which the rest of a chatter must end */
#define BETWEEN 32   /* flights or steps of series between two marks */
#define TURNS 100     /* events without an advance of time from which on rigid contacts come to rest */
#define STILL 1000   /* events without an advance of time that end a solve */
#define LOOSE 4       /* events without an advance of time from which on a spring's contact moves by rounding alone */
#define ROUNDINGS 64.0

typedef struct { /* Taylor series at one time */
    double *a, *u, *lam, *G; /* (MOST, n) modes, (MOST, m) positions, (MOST, m) forces, (MOST, B) drive */
    Int *held;               /* rigid contacts that are held */
    double *inverse, *A;     /* of their rows rows^T; scratch */
} Series;

typedef struct { /* a flight from t on */
    Int T, deg;           /* terms, degree of the slides */
    double *z;            /* (2, N) amplitudes of the exponentials */
    double *poly;         /* (2, N, ROOM) of a mode (x, y if complex) beside its exponential: a polynomial in tau */
    Int *degree;          /* (N,) of it; -1 for none */
    double *Z, *slide;    /* (2, m, T), (m, ROOM): the same as a contact sees it */
    double *sizes;        /* (m, T) |Z| */
    double *C, *S, *x, *y; /* (T,) scratch */
    double *h;            /* (2 n) */
    double *c;            /* (R, 4) records at t */
} Flight;

typedef struct { double s; Int contact, side; } Event; /* contact -1: none until s */

typedef struct { /* one call */
    const Free *free;
    State *c;
    double t_end, free_fast;
    int full; /* terms of a series at full length */
    Series s;
    Flight g;
    Node node;
    Law *law; /* of the contacts of an impact */
    double *turned, *turned_rate, *P, *r, *v, *b, *inward; /* scratch; of impacts */
    Int *on, *at, *left;
    Output *out;
} Motion;

static double stop_of(const Free *f, Int i, Int side) { return f->stops[2 * i + (side > 0)]; }
static int rigid(const Free *f, Int i) { return isinf(f->laws[3 * i]); }
static int presses(const State *c, Int i) { return c->side[i] == 1 || c->side[i] == -1; }

/* Sum of the sizes of the terms of row_i x. */
static double terms_of(const Free *f, Int i, const double *x)
{
    double terms = 0.0;
    for (Int j = 0; j < f->n; j++) terms += fabs(f->rows[i * f->n + j] * x[j]);
    return terms;
}

/* ------------------------------------------------------------------ series */

/* Terms of a series over x radians: what is left out is below rounding. */
static int terms_for(double x)
{
    int k = 1;
    for (double size = x; (size > 1e-17 || k < 8) && k < MOST - 1; size *= x / k) k++;
    return k;
}

/* Record r as a cubic in the time since t. */
static void record_at(const Free *f, Int piece, Int r, double t, double *out)
{
    const double *c = f->pieces + 4 * (piece * f->R + r), x = t - f->edges[piece];
    out[0] = c[0] + x * (c[1] + x * (c[2] + x * c[3]));
    out[1] = c[1] + x * (2.0 * c[2] + x * 3.0 * c[3]);
    out[2] = c[2] + 3.0 * x * c[3];
    out[3] = c[3];
}

/* Taylor coefficients (K+1, B) of the drive at t. */
static void drive_series(const Free *f, double t, Int piece, int K, double *G)
{
    Int B = 2 * f->F + f->R;
    memset(G, 0, (size_t)((K + 1) * B) * sizeof *G);
    for (Int i = 0; i < f->F; i++) {
        double w = f->waves[i], s = sin(w * t), c = cos(w * t), over = 1.0;
        for (int k = 0; k <= K; k++, over *= w / k) {
            double old = s;
            G[k * B + 2 * i] = s * over, G[k * B + 2 * i + 1] = c * over;
            s = c, c = -old;
        }
    }
    for (Int r = 0; r < f->R; r++) {
        double c[4];
        record_at(f, piece, r, t, c);
        for (int k = 0; k < 4; k++) G[k * B + 2 * f->F + r] = c[k];
    }
}

HOT static void free_term(double *restrict new, const double *restrict before, const double *restrict old,
                          const double *restrict w2, const double *restrict drag, double k, Int n)
{
    for (Int j = 0; j < n; j++) new[j] = (1.0 - k) * drag[j] * before[j] - w2[j] * old[j];
}

/* Term k of the force on a spring and dashpot at a stop. */
static double spring_term(const Free *f, const Series *s, int k, Int i, Int side)
{
    double g = k == 0 ? stop_of(f, i, side) : 0.0;
    return f->laws[3 * i] * (s->u[k * f->m + i] - g) + f->laws[3 * i + 1] * (k + 1.0) * s->u[(k + 1) * f->m + i];
}

/* The contacts that rigid stops hold, and the inverse of their rows rows^T. */
static Int hold(const Free *f, const State *c, Series *s)
{
    Int m = f->m, count = 0;
    for (Int i = 0; i < m; i++)
        if (presses(c, i) && rigid(f, i)) s->held[count++] = i;
    for (Int z = 0; z < count; z++) {
        double *column = s->inverse + z * count;
        for (Int x = 0; x < count; x++) {
            column[x] = x == z;
            for (Int y = 0; y < count; y++) s->A[x * count + y] = f->meet[s->held[x] * m + s->held[y]];
        }
        eliminate(s->A, column, count);
    }
    return count;
}

/* Term k of all modes: inertia against stiffness, loads, damping, springs, and the reactions of what is held. */
static void term(const Free *f, const State *c, Series *s, int k, Int count)
{
    Int n = f->n, m = f->m, B = 2 * f->F + f->R;
    double *new = s->a + k * n, *before = new - n, *old = before - n, *lam = s->lam + (k - 2) * m;
    free_term(new, before, old, f->w2, f->drag, f->coupling == 1 ? k : 1.0, n);
    for (Int b = 0; b < B; b++)
        if (s->G[(k - 2) * B + b] != 0.0) add(new, f->loads + b * n, s->G[(k - 2) * B + b], n);
    for (Int j = 0; f->coupling == 2 && j < n; j++) new[j] -= (k - 1.0) * dot(f->damping + j * n, before, n);
    for (Int i = 0; i < m; i++)
        if (presses(c, i) && !rigid(f, i)) {
            lam[i] = -spring_term(f, s, k - 2, i, c->side[i]);
            add(new, f->rows + i * n, lam[i], n);
        }
    for (int pass = 0; pass < 2; pass++) { /* the second takes what rounding left: what is held everywhere stays at rest */
        double *more = s->A;
        for (Int y = 0; y < count; y++) more[y] = 0.0;
        for (Int x = 0; x < count; x++) {
            double r = dot(f->rows + s->held[x] * n, new, n);
            for (Int b = 0; b < B; b++) r += f->offsets[b * m + s->held[x]] * s->G[k * B + b] * k * (k - 1.0);
            for (Int y = 0; y < count; y++) more[y] -= s->inverse[y * count + x] * r;
        }
        for (Int x = 0; x < count; x++) lam[s->held[x]] += more[x], add(new, f->rows + s->held[x] * n, more[x], n);
    }
    for (Int j = 0; j < n; j++) new[j] *= 1.0 / (k * (k - 1.0));
}

/* At t the series a (K+1, n) of the modes, u (K+1, m) of the positions, lam (K+1, m) of the contact forces. */
static void expand(const Free *f, double t, Int piece, int K, const double *eta, const double *rate, const State *c, Series *s)
{
    Int n = f->n, m = f->m, B = 2 * f->F + f->R, count = hold(f, c, s);
    drive_series(f, t, piece, K, s->G);
    memset(s->lam, 0, (size_t)((K + 1) * m) * sizeof(double));
    memcpy(s->a, eta, (size_t)n * sizeof(double));
    memcpy(s->a + n, rate, (size_t)n * sizeof(double));
    for (int k = 0; k <= K; k++) {
        double *u = s->u + k * m;
        if (k >= 2) term(f, c, s, k, count);
        for (Int i = 0; i < m; i++) u[i] = dot(f->rows + i * n, s->a + k * n, n);
        for (Int b = 0; b < B; b++)
            if (s->G[k * B + b] != 0.0)
                for (Int i = 0; i < m; i++) u[i] += f->offsets[b * m + i] * s->G[k * B + b];
    }
}

/* Value and rate of a series at s. */
HOT static void horner(const double *restrict a, int K, double s, double *restrict eta, double *restrict rate, Int n)
{
    for (Int j = 0; j < n; j++) eta[j] = a[K * n + j], rate[j] = 0.0;
    for (int k = K - 1; k >= 0; k--)
        for (Int j = 0; j < n; j++) {
            rate[j] = rate[j] * s + eta[j];
            eta[j] = eta[j] * s + a[k * n + j];
        }
}

/* The modes at the end of a step. `lost` (2, n) keeps what rounding cuts off: else a million steps would err by a
 * million roundings. e and r are scratch. */
HOT static void advance(const double *restrict a, int K, double s, double *restrict eta, double *restrict rate,
                        double *restrict lost, double *restrict e, double *restrict r, Int n)
{
    for (Int j = 0; j < n; j++) e[j] = a[K * n + j], r[j] = 0.0;
    for (int k = K - 1; k > 1; k--)
        for (Int j = 0; j < n; j++) {
            r[j] = r[j] * s + e[j];
            e[j] = e[j] * s + a[k * n + j];
        }
    for (Int j = 0; j < n; j++) {
        double y = s * (a[n + j] + s * e[j]) - lost[j];
        eta[j] = a[j] + y;
        lost[j] = (eta[j] - a[j]) - y;
        y = s * (2.0 * e[j] + s * r[j]) - lost[n + j];
        rate[j] = a[n + j] + y;
        lost[n + j] = (rate[j] - a[n + j]) - y;
    }
}

/* A bound of the speed of all motions with the contacts as they are. */
static double fastest(const Free *f, const State *c)
{
    double k = 0.0, dash = 0.0;
    for (Int i = 0; i < f->m; i++) {
        double x = 0.0, y = 0.0;
        for (Int j = 0; j < f->m; j++)
            if (presses(c, i) && !rigid(f, i) && presses(c, j) && !rigid(f, j)) {
                x += sqrt(f->laws[3 * i] * f->laws[3 * j]) * fabs(f->meet[i * f->m + j]);
                y += sqrt(f->laws[3 * i + 1] * f->laws[3 * j + 1]) * fabs(f->meet[i * f->m + j]);
            }
        k = most(k, x), dash = most(dash, y);
    }
    double d = 0.5 * (f->decay + dash);
    return most(d + sqrt(d * d + f->stiffest + k), f->fastest_wave);
}

/* Coefficients (K+1,) of the rounding of a contact's position. */
static void rounding_of(const Free *f, const Series *s, Int i, int K, double *noise)
{
    for (int k = 0; k <= K; k++) noise[k] = ROUNDINGS * EPS * terms_of(f, i, s->a + k * f->n);
}

/* Coefficients (K-1,) of the rounding of a held contact's reaction: that of all forces on it. */
static void reaction_rounding(const Free *f, const Series *s, Int i, int K, double *noise)
{
    Int n = f->n, m = f->m;
    for (int k = 0; k < K - 1; k++) {
        double terms = 0.0;
        for (Int j = 0; j < n; j++) {
            double force = (k + 1.0) * (k + 2.0) * fabs(s->a[(k + 2) * n + j]) + f->w2[j] * fabs(s->a[k * n + j]);
            for (Int l = 0; l < m; l++) force += fabs(f->rows[l * n + j] * s->lam[k * m + l]);
            terms += fabs(f->rows[i * n + j]) * force;
        }
        noise[k] = ROUNDINGS * EPS * terms / f->meet[i * m + i];
    }
}

/* Coefficients (K+1,) of sign (u - g) of contact i, with the noise of its rounding added. */
static void gap_of(const Series *s, Int m, Int i, int K, double sign, double g, const double *noise, double *p)
{
    for (int k = 0; k <= K; k++) p[k] = sign * s->u[k * m + i] + noise[k];
    p[0] -= sign * g;
}

/* The first event within h of a series. Gaps and forces of contacts with `slack` count from there on. */
static Event watch(const Free *f, int K, double h, const State *c, const Series *s)
{
    Event e = {h, -1, 0};
    double p[MOST + 1], noise[MOST + 1];
    Int m = f->m;
    for (Int i = 0; i < m; i++)
        for (Int way = 1; way >= -1; way -= 2) {
            double g = stop_of(f, i, way), kappa = f->laws[3 * i], dash = f->laws[3 * i + 1], at;
            Int side = c->side[i], found = way;
            if (isinf(g) || (side != 0 && (side > 0) != (way > 0))) continue;
            int loose = c->slack[i] > 0.0, zeros = c->fresh_side[i] == way && !loose ? (int)c->fresh[i] : 0;
            memset(noise, 0, sizeof noise);
            if (loose) {
                rounding_of(f, s, i, K, noise);
                noise[0] += ROUNDINGS * EPS * fabs(g) + c->slack[i];
            }
            if (side == 0 || (presses(c, i) && !rigid(f, i) && dash == 0.0)) { /* a gap, or a depth */
                gap_of(s, m, i, K, (double)(side == 0 ? -way : way), g, noise, p);
                if (rigid(f, i) && zeros == 1) p[1] = c->speed[i];
                at = first_zero(p, K + 1, e.s, zeros);
            } else if (rigid(f, i)) { /* a reaction */
                reaction_rounding(f, s, i, K, noise);
                for (int k = 0; k < K - 1; k++) p[k] = -(double)way * s->lam[k * m + i] + noise[k];
                at = first_zero(p, K - 1, e.s, zeros);
            } else { /* the force of a damped stop, or that which is cut off where it has let go */
                double sign = (double)(presses(c, i) ? way : -way);
                for (int k = 0; k < K; k++)
                    p[k] = sign * spring_term(f, s, k, i, way) + kappa * noise[k] + dash * (k + 1.0) * noise[k + 1];
                at = first_zero(p, K, e.s, zeros);
            }
            if (side != 0 && !presses(c, i)) { /* let go: it opens */
                gap_of(s, m, i, K, (double)way, g, noise, p);
                double other = first_zero(p, K + 1, e.s, 0);
                if (other >= 0.0 && (at < 0.0 || other <= at)) at = other, found = 2 * way;
            }
            if (at >= 0.0 && (at < e.s || e.contact < 0)) e = (Event){at, i, found};
        }
    return e;
}

/* ------------------------------------------------------------------ flight */

/* exp(sigma tau) cos, sin(omega tau) of `count` poles: reduction by pi/2 in three parts and the polynomials of fdlibm,
 * written without a branch, so that compilers use vector registers. Adding and taking away 1.5 2^52 rounds to an
 * integer. `last` bounds omega. */
HOT static void waves_at(const double *restrict sigma, const double *restrict omega, Int count, Int damped, double last,
                         double tau, double *restrict C, double *restrict S)
{
    const double round = 6755399441055744.0;
    if (last * tau > 1.6e6)
        for (Int k = 0; k < count; k++) C[k] = cos(omega[k] * tau), S[k] = sin(omega[k] * tau);
    else
        for (Int k = 0; k < count; k++) {
            double x = omega[k] * tau, q = (x * 0.63661977236758134308 + round) - round;
            double r = ((x - q * 1.57079632673412561417) - q * 6.07710050630396597660e-11) - q * 2.02226624871116645580e-21;
            double z = r * r;
            double sine = r + r * z * (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z * (
                -1.98412698298579493134e-04 + z * (2.75573137070700676789e-06 + z * (
                    -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
            double cosine = 1.0 - 0.5 * z + z * z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * (
                2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07 + z * (
                    2.08757232129817482790e-09 - z * 1.13596475577881948265e-11)))));
            double half = 0.5 * q - 0.25, odd = q - 2.0 * ((half + round) - round); /* the quarter turns q = 2 p + odd */
            double p = 0.5 * (q - odd), flip = 1.0 - 2.0 * fabs(p - 2.0 * ((0.5 * p + round) - round));
            C[k] = flip * ((1.0 - odd) * cosine - odd * sine);
            S[k] = flip * ((1.0 - odd) * sine + odd * cosine);
        }
    for (Int k = 0; damped && k < count; k++) {
        double e = exp(sigma[k] * tau);
        C[k] *= e;
        S[k] *= e;
    }
}

/* The particular solution of the harmonic loads, and its rate, at t. */
HOT static void respond(const Free *f, double t, double *restrict eta, double *restrict rate)
{
    Int n = f->n;
    for (Int j = 0; j < n; j++) eta[j] = rate[j] = 0.0;
    for (Int i = 0; i < f->F; i++) {
        double w = f->waves[i], s = sin(w * t), c = cos(w * t);
        const double *restrict of_sin = f->answer + 2 * i * n, *restrict of_cos = of_sin + n;
        for (Int j = 0; j < n; j++) {
            eta[j] += s * of_sin[j] + c * of_cos[j];
            rate[j] += w * (c * of_sin[j] - s * of_cos[j]);
        }
    }
}

/* Mode j beside its exponential, as a polynomial `out` in tau, from h, v on under the loads that are polynomials;
 * returns its degree, -1 for none. A fast mode: the particular solution (h, v are left to the exponential). A mode that
 * turns by less than a radian during the flight: all of its motion, since its particular solution is far larger than
 * the motion, and would cancel; so also a free body. A mode `apart`: all of its motion under all loads, whose Taylor
 * coefficients are G. */
static int beside(const Free *f, Int j, const double *G, const double *c, double length, double h, double v, double *out)
{
    Int N = f->N, T = N + f->F, B = 2 * f->F, all = B + f->R;
    double omega = f->poles[T + j], w2 = f->w2[j], d = f->drag[j], p[4] = {0.0, 0.0, 0.0, 0.0};
    if (f->apart[j]) {
        int degree = terms_for(1.0);
        out[0] = h, out[1] = v;
        for (int k = 0; k + 2 <= degree; k++) {
            double load = 0.0;
            for (Int b = 0; b < all; b++) load += G[k * all + b] * f->loads[b * f->n + j];
            out[k + 2] = (load - (k + 1.0) * d * out[k + 1] - w2 * out[k]) / ((k + 1.0) * (k + 2.0));
        }
        return degree;
    }
    if (f->R == 0 && omega > 0.0) return -1;
    for (Int r = 0; r < f->R; r++)
        for (int k = 0; k < 4; k++) p[k] += f->loads[(B + r) * f->n + j] * c[4 * r + k];
    if (omega > 0.0 && w2 * length * length > 1.0) {
        for (int k = 3; k >= 0; k--) {
            double x = p[k];
            if (k < 3) x -= (k + 1.0) * d * out[k + 1];
            if (k < 2) x -= (k + 1.0) * (k + 2.0) * out[k + 2];
            out[k] = x / w2;
        }
        return 3;
    }
    for (Int i = 0; omega == 0.0 && i < f->F; i++) /* constants have no static answer of a free body */
        if (f->waves[i] == 0.0) p[0] += f->loads[(2 * i + 1) * f->n + j];
    int degree = omega > 0.0 ? terms_for(1.0) : f->R ? 5 : 2;
    out[0] = h, out[1] = v;
    for (int k = 0; k + 2 <= degree; k++)
        out[k + 2] = ((k < 4 ? p[k] : 0.0) - (k + 1.0) * d * out[k + 1] - w2 * out[k]) / ((k + 1.0) * (k + 2.0));
    return degree;
}

/* The same of complex mode k, whose amplitude z obeys z' = pole z + b(tau): its polynomial re + i im in place of h, v.
 * z becomes what is left to the exponential. */
static int beside_complex(const Free *f, Int k, const double *c, double length, double z[2], double *re, double *im)
{
    Int n = f->n, N = f->N, B = 2 * f->F;
    double sigma = f->poles[k], omega = f->poles[N + f->F + k], size = sigma * sigma + omega * omega, b[2][4] = {{0.0}, {0.0}};
    if (f->R == 0) return -1;
    for (Int r = 0; r < f->R; r++)
        for (int part = 0; part < 2; part++) {
            double x = dot(f->back + (part * N + k) * 2 * n + n, f->loads + (B + r) * n, n);
            for (int l = 0; l < 4; l++) b[part][l] += x * c[4 * r + l];
        }
    if (size * length * length > 1.0) {
        for (int l = 3; l >= 0; l--) {
            double x = (l < 3 ? (l + 1.0) * re[l + 1] : 0.0) - b[0][l], y = (l < 3 ? (l + 1.0) * im[l + 1] : 0.0) - b[1][l];
            re[l] = (x * sigma + y * omega) / size, im[l] = (y * sigma - x * omega) / size;
        }
        z[0] -= re[0], z[1] -= im[0];
        return 3;
    }
    int degree = terms_for(1.0);
    re[0] = z[0], im[0] = z[1], z[0] = z[1] = 0.0;
    for (int l = 0; l < degree; l++) {
        re[l + 1] = (sigma * re[l] - omega * im[l] + (l < 4 ? b[0][l] : 0.0)) / (l + 1.0);
        im[l + 1] = (sigma * im[l] + omega * re[l] + (l < 4 ? b[1][l] : 0.0)) / (l + 1.0);
    }
    return degree;
}

/* A flight from t on, of at most `length`: the amplitudes of its modes and their polynomials. G: scratch. */
static void launch(const Free *f, double t, Int piece, double length, const double *eta, const double *rate, double *G,
                   Flight *g)
{
    Int n = f->n, N = f->N, m = f->m, T = N + f->F;
    int turns = f->kind == 2;
    g->T = T, g->deg = 0;
    respond(f, t, g->h, g->h + n);
    memset(g->slide, 0, (size_t)(m * ROOM) * sizeof(double));
    for (Int r = 0; r < f->R; r++) {
        record_at(f, piece, r, t, g->c + 4 * r);
        for (Int i = 0; i < m; i++) { /* stops that move by a record */
            double factor = f->offsets[(2 * f->F + r) * m + i];
            for (int k = 0; k < 4 && factor != 0.0; k++) g->slide[i * ROOM + k] += factor * g->c[4 * r + k], g->deg = 3;
        }
    }
    /* The state beside the harmonic solution, mode by mode. */
    for (Int j = 0; j < n; j++) g->h[j] = eta[j] - g->h[j], g->h[n + j] = rate[j] - g->h[n + j];
    if (!turns && isfinite(f->longest)) drive_series(f, t, piece, terms_for(1.0), G);
    for (Int k = 0; k < N; k++) {
        double z[2], *re = g->poly + k * ROOM, *im = re + N * ROOM;
        int degree;
        if (turns) {
            for (int part = 0; part < 2; part++) z[part] = dot(f->back + (part * N + k) * 2 * n, g->h, 2 * n);
            degree = beside_complex(f, k, g->c, length, z, re, im);
        } else {
            double h = g->h[k], v = g->h[n + k], sigma = f->poles[k], omega = f->poles[T + k];
            degree = beside(f, k, G, g->c, length, h, v, re);
            if (degree == 3) h -= re[0], v -= re[1];
            else if (degree >= 0) h = v = 0.0;
            z[0] = h, z[1] = omega > 0.0 ? (sigma * h - v) / omega : 0.0;
        }
        g->degree[k] = degree, g->z[k] = z[0], g->z[N + k] = z[1];
        if (degree > g->deg) g->deg = degree;
        for (Int i = 0; i < m; i++)
            for (int l = 0; l <= degree; l++) {
                g->slide[i * ROOM + l] += f->seen[i * N + k] * re[l];
                if (turns) g->slide[i * ROOM + l] -= f->seen[(m + i) * N + k] * im[l];
            }
    }
}

/* What the contacts see of a flight: amplitudes of the poles from slow to fast. */
static void see(const Free *f, double t, Flight *g)
{
    Int n = f->n, N = f->N, m = f->m, T = g->T;
    double *Zx = g->Z, *Zy = g->Z + m * T;
    for (Int at = 0; at < T; at++) {
        Int k = f->order[at];
        double c = k < N ? g->z[k] : cos(f->waves[k - N] * t), s = k < N ? g->z[N + k] : sin(f->waves[k - N] * t);
        for (Int i = 0; i < m; i++) {
            double x, y; /* times c + i s */
            if (k >= N) {
                x = f->offsets[(2 * (k - N) + 1) * m + i] + dot(f->rows + i * n, f->answer + (2 * (k - N) + 1) * n, n);
                y = -f->offsets[2 * (k - N) * m + i] - dot(f->rows + i * n, f->answer + 2 * (k - N) * n, n);
            } else {
                x = f->seen[i * N + k], y = f->seen[(m + i) * N + k];
            }
            Zx[i * T + at] = x * c - y * s, Zy[i * T + at] = x * s + y * c;
            g->sizes[i * T + at] = hypot(Zx[i * T + at], Zy[i * T + at]);
        }
    }
}

/* The modes at tau. */
static void land(const Free *f, const Flight *g, double t, double tau, double *eta, double *rate)
{
    Int n = f->n, N = f->N, T = g->T;
    const double *sigma = f->poles, *omega = f->poles + T, *z = g->z;
    waves_at(sigma, omega, N, f->damped, T ? f->sorted[2 * T + T - 1] : 0.0, tau, g->C, g->S);
    respond(f, t + tau, eta, rate);
    if (f->kind == 2) {
        for (Int k = 0; k < N; k++) {
            const double *re = g->poly + k * ROOM, *im = re + N * ROOM;
            g->x[k] = z[k] * g->C[k] - z[N + k] * g->S[k], g->y[k] = z[k] * g->S[k] + z[N + k] * g->C[k];
            if (g->degree[k] >= 0) g->x[k] += value(re, (int)g->degree[k], tau), g->y[k] += value(im, (int)g->degree[k], tau);
        }
        for (Int j = 0; j < n; j++) {
            const double *out = f->out + j * N;
            eta[j] += dot(out, g->x, N) - dot(out + n * N, g->y, N);
            rate[j] += dot(out + 2 * n * N, g->x, N) - dot(out + 3 * n * N, g->y, N);
        }
        return;
    }
    for (Int j = 0; j < n; j++) {
        double x = z[j] * g->C[j] - z[n + j] * g->S[j], y = z[j] * g->S[j] + z[n + j] * g->C[j], u = 0.0, v = 0.0;
        for (Int k = g->degree[j]; k >= 0; k--) {
            v = v * tau + u;
            u = u * tau + g->poly[j * ROOM + k];
        }
        eta[j] += x + u;
        rate[j] += sigma[j] * x - omega[j] * y + v;
    }
}

/* The slide of contact i as a polynomial in the time since tau: p[0..K]. Returns the size of what is summed. */
static double slide_at(const Flight *g, Int i, double tau, int K, double *p)
{
    const double *c = g->slide + i * ROOM;
    double size = 0.0;
    for (int k = 0; k <= K; k++) p[k] = k <= g->deg ? c[k] : 0.0;
    for (int k = (int)g->deg; k >= 0; k--) size = size * tau + fabs(c[k]);
    for (int k = 0; k < g->deg; k++)
        for (int l = (int)g->deg - 1; l >= k; l--) p[l] += tau * p[l + 1];
    return size;
}

/* p: the series of the position of contact i at tau, of degree K, from its `slow` slowest terms. rest: a bound of the
 * others. Returns one of all. */
HOT static double gap_series(const Free *f, const Flight *g, Int i, double tau, Int slow, int K, double *p, double *rest)
{
    Int T = g->T;
    const double *restrict Zx = g->Z + i * T, *restrict Zy = g->Z + (f->m + i) * T, *restrict C = g->C, *restrict S = g->S;
    const double *restrict sigma = f->sorted, *restrict omega = sigma + T, *restrict sizes = g->sizes + i * T;
    double *restrict x = g->x, *restrict y = g->y, fast = 0.0, every = slide_at(g, i, tau, K, p);
#pragma omp simd reduction(+ : every)
    for (Int k = 0; k < slow; k++) {
        x[k] = Zx[k] * C[k] - Zy[k] * S[k], y[k] = Zx[k] * S[k] + Zy[k] * C[k];
        every += fabs(x[k]) + fabs(y[k]);
    }
#pragma omp simd reduction(+ : fast)
    for (Int k = slow; k < T; k++) fast += sizes[k] * sqrt(C[k] * C[k] + S[k] * S[k]);
    for (int l = 0; l <= K; l++) {
        double over = 1.0 / (l + 1.0), sum = 0.0;
#pragma omp simd reduction(+ : sum)
        for (Int k = 0; k < slow; k++) {
            double old = x[k];
            sum += old;
            x[k] = (sigma[k] * old - omega[k] * y[k]) * over;
            y[k] = (sigma[k] * y[k] + omega[k] * old) * over;
        }
        p[l] += sum;
    }
    *rest = fast;
    return every + fast;
}

/* Looks at the gaps over [tau, tau + h] with the terms below `slow` as series. False where a leap must be shorter to
 * tell. Where the series is all there is (slow = T), it decides. */
static int leap_is_clear(const Free *f, Flight *g, double tau, double h, Int slow, int K, const State *c, Event *e)
{
    double p[MOST + 1], gap[MOST + 1], b[MOST + 1], rest;
    for (Int i = 0; i < f->m; i++) {
        double every = gap_series(f, g, i, tau, slow, K, p, &rest);
        for (Int side = 1; side >= -1; side -= 2) {
            double stop = stop_of(f, i, side), way = (double)(c->side[i] == 0 ? -side : side);
            if (isinf(stop) || c->side[i] == -side) continue;
            for (int k = 0; k <= K; k++) gap[k] = way * p[k]; /* of an open contact; the depth of a pressed one */
            gap[0] -= way * stop;
            if (slow == g->T) {
                int zeros = tau == 0.0 && c->fresh_side[i] == side ? (int)c->fresh[i] : 0;
                if (zeros == 1 && c->speed[i] > 0.0) gap[1] = c->speed[i];
                double s = first_zero(gap, K + 1, e->s, zeros);
                if (s >= 0.0) *e = (Event){s, i, side};
                continue;
            }
            scaled(gap, K, h, b);
            bernstein(b, K);
            double wrong = rest + EPS * (20.0 + 2.0 * sqrt((double)g->T)) * (fabs(stop) + every);
            for (int k = 0; k <= K; k++)
                if (!(b[k] > wrong)) return 0;
        }
    }
    return 1;
}

/* The first gap that closes within `length`. A leap h takes the terms below radians/h as a series. The state keeps
 * its length for a flight that goes on where this one ends. */
static Event flight(const Free *f, Flight *g, double length, State *c)
{
    Int T = g->T;
    int K = terms_for(RADIANS);
    const double *speed = f->sorted + 2 * T;
    double fast = most(T ? speed[T - 1] : 0.0, 1.0 / length), tau = 0.0, wish = most(RADIANS / fast, c->leap);
    if (K < g->deg) K = (int)g->deg;
    for (;;) {
        double h = least(wish, length - tau);
        Int slow = T;
        while (slow && speed[slow - 1] * h > RADIANS * (1.0 + 1e-9)) slow--;
        waves_at(f->sorted, f->sorted + T, T, f->damped, T ? speed[T - 1] : 0.0, tau, g->C, g->S);
        c->evaluations++;
        Event e = {h, -1, 0};
        if (!leap_is_clear(f, g, tau, h, slow, K, c, &e)) {
            wish = 0.4 * h;
            continue;
        }
        c->leap = e.contact < 0 ? wish : 0.0;
        if (e.contact >= 0 || tau + h >= length) {
            e.s += tau;
            return e;
        }
        tau += h, wish = 3.0 * h;
    }
}

/* ------------------------------------------------------------------ stretches: a flight, or a step of series */

static void expand_here(Motion *x, int K) { expand(x->free, x->c->t, x->c->piece, K, x->c->eta, x->c->rate, x->c, &x->s); }

/* The free system, or that with its only contact pressed, if a closed form is at hand; NULL for none. Short motions
 * from rest would cancel in closed form. Shortens `length` to what its polynomials allow. */
static const Free *flies(const Motion *x, double *length)
{
    const Free *f = x->free;
    const Int *side = x->c->side;
    if (f->m == 1 && side[0] != 0) {
        f = side[0] == 1 ? f->up : side[0] == -1 ? f->low : NULL;
        if (!f || f->kind == 0) return NULL;
    } else {
        for (Int i = 0; i < f->m; i++)
            if (side[i] != 0) return NULL;
        if (!f->kind) return NULL;
    }
    for (Int i = 0; i < f->m; i++)
        if (x->c->slack[i] > 0.0) return NULL;
    double most_of_it = least(*length, f->longest);
    if (!(most_of_it * x->free_fast > 4.0 * RADIANS)) return NULL;
    *length = most_of_it;
    return f;
}

/* Coordinates in the modes with the only contact pressed, and back. */
static void to_pressed(const double *V, const double *x, double *y, Int n)
{
    for (Int k = 0; k < n; k++) y[k] = dot(V + k * n, x, n);
}

static void from_pressed(const double *V, const double *y, double *x, Int n)
{
    memset(x, 0, (size_t)n * sizeof *x);
    add_rows(x, n, y, V, n, n);
}

/* Begins a stretch of at most `length`: what flies, or NULL for a step of series of K terms. Returns its length. */
static double begin(Motion *x, double length, const Free **flown, int *K)
{
    Int n = x->free->n;
    State *c = x->c;
    *flown = flies(x, &length);
    if (*flown) {
        const double *eta = c->eta, *rate = c->rate;
        if (*flown != x->free) {
            to_pressed(x->free->V, eta, x->turned, n), to_pressed(x->free->V, rate, x->turned_rate, n);
            eta = x->turned, rate = x->turned_rate;
        }
        launch(*flown, c->t, c->piece, length, eta, rate, x->s.G, &x->g);
        return length;
    }
    double fast = fastest(x->free, c), h = least(RADIANS / fast, length);
    *K = terms_for(h * fast);
    expand_here(x, *K);
    return h;
}

/* The modes at tau of a stretch: at its start not even rounding changes them. */
static void state_at(Motion *x, const Free *flown, int K, double tau, double *eta, double *rate)
{
    Int n = x->free->n;
    if (tau == 0.0) memcpy(eta, x->c->eta, (size_t)n * sizeof(double)), memcpy(rate, x->c->rate, (size_t)n * sizeof(double));
    else if (!flown) horner(x->s.a, K, tau, eta, rate, n);
    else if (flown == x->free) land(flown, &x->g, x->c->t, tau, eta, rate);
    else {
        land(flown, &x->g, x->c->t, tau, x->turned, x->turned_rate);
        from_pressed(x->free->V, x->turned, eta, n);
        from_pressed(x->free->V, x->turned_rate, rate, n);
    }
}

/* The reactions of held contacts at tau of a stretch. */
static void forces_at(const Motion *x, const Free *flown, int K, double tau, double *force)
{
    Int m = x->free->m;
    for (Int i = 0; i < m; i++) {
        force[i] = 0.0;
        if (flown || !presses(x->c, i) || !rigid(x->free, i)) continue;
        for (int k = K - 2; k >= 0; k--) force[i] = force[i] * tau + x->s.lam[k * m + i];
    }
}

/* The state moves to the end of a stretch at tau. */
static void move(Motion *x, const Free *flown, int K, double tau)
{
    State *c = x->c;
    Int n = x->free->n;
    double y = tau - c->late, next = c->t + y;
    if (flown) {
        state_at(x, flown, K, tau, c->eta, c->rate);
        memset(c->lost, 0, (size_t)(2 * n) * sizeof(double));
        c->late = 0.0;
    } else {
        advance(x->s.a, K, tau, c->eta, c->rate, c->lost, x->turned, x->turned_rate, n);
        c->late = (next - c->t) - y;
    }
    c->t = next;
}

/* Time to the next sample of a record, or to `until`; the records' piece at the time. */
static double room_for(Motion *x, double until)
{
    const Free *f = x->free;
    State *c = x->c;
    while (c->piece + 1 < f->E && f->edges[c->piece + 1] <= c->t + 4.0 * EPS * c->t) c->piece++;
    double length = until - c->t;
    return c->piece + 1 < f->E ? least(length, f->edges[c->piece + 1] - c->t) : length;
}

/* ------------------------------------------------------------------ rigid stops */

/* P with w = S P + r, 0 <= P _|_ w >= 0 among the closed contacts, outward; firm: w = 0 of all of them. */
static void push(Motion *x, int firm)
{
    Int m = x->free->m;
    for (Int i = 0; i < m; i++) {
        Int stop = x->c->closed[i];
        int upper = stop > 0 || (firm && stop), lower = stop < 0 || (firm && stop);
        x->law[i] = (Law){.kappa = INFINITY, .g1 = lower ? 0.0 : -INFINITY, .g2 = upper ? 0.0 : INFINITY};
        x->inward[i] = -(double)stop * x->r[i];
    }
    solve_springs(x->inward, x->free->meet, m, x->law, m, &x->node);
    for (Int i = 0; i < m; i++) x->P[i] = -(double)x->c->closed[i] * x->node.F[i];
}

/* Derivative `order`, 0 or 1, of the position of contact i. The drive must have been expanded at t. */
static double position(const Motion *x, Int i, int order)
{
    const Free *f = x->free;
    Int B = 2 * f->F + f->R;
    double u = dot(f->rows + i * f->n, order ? x->c->rate : x->c->eta, f->n);
    for (Int b = 0; b < B; b++) u += f->offsets[b * f->m + i] * x->s.G[order * B + b];
    return u;
}

/* v: the rates at which the gaps of the closed contacts open. */
static void outward(Motion *x, double *v)
{
    for (Int i = 0; i < x->free->m; i++) v[i] = -(double)x->c->closed[i] * position(x, i, 1);
}

/* An event at t: a contact changes its side, REBOUND times the stop where it is thrown back at once. */
static void note(Motion *x, Int contact, Int side)
{
    Output *o = x->out;
    o->event_t[o->events] = x->c->t, o->event_contact[o->events] = contact;
    o->event_side[o->events] = side, o->event_mark[o->events++] = o->marks;
}

/* Closed are the contacts that rigid stops hold, and contact i on `stop`. */
static void close_held(Motion *x, Int i, Int stop)
{
    for (Int k = 0; k < x->free->m; k++) x->c->closed[k] = rigid(x->free, k) ? x->c->side[k] : 0;
    x->c->closed[i] = stop;
}

/* Rounding of the rate of contact i. The drive must have been expanded at t. */
static double rate_rounding(const Motion *x, Int i)
{
    const Free *f = x->free;
    Int B = 2 * f->F + f->R;
    double terms = terms_of(f, i, x->c->rate);
    for (Int b = 0; b < B; b++) terms += fabs(f->offsets[b * f->m + i] * x->s.G[B + b]);
    return 4.0 * EPS * terms;
}

/* The impulses P act; x->v are the speeds before, and then those behind. */
static void blow(Motion *x)
{
    const Free *f = x->free;
    Output *o = x->out;
    Int first = o->blows;
    for (Int i = 0; i < f->m; i++)
        if (x->P[i] != 0.0) {
            add(x->c->rate, f->rows + i * f->n, -(double)x->c->closed[i] * x->P[i], f->n);
            o->blow_t[o->blows] = x->c->t, o->blow_contact[o->blows] = i, o->blow_impulse[o->blows] = -(double)x->c->closed[i] * x->P[i];
            o->blow_before[o->blows] = -(double)x->c->closed[i] * x->v[i], o->blow_side[o->blows] = x->c->closed[i], o->blow_mark[o->blows++] = o->marks;
        }
    outward(x, x->v);
    for (Int k = first; k < o->blows; k++) o->blow_after[k] = -(double)x->c->closed[o->blow_contact[k]] * x->v[o->blow_contact[k]];
}

/* The closed contacts stop. */
static void halt(Motion *x)
{
    outward(x, x->v);
    memcpy(x->r, x->v, (size_t)x->free->m * sizeof(double));
    push(x, 1);
    blow(x);
}

/* Open rigid contacts that reach their stops together with `hit` but for rounding are closed as well; each is an event. */
static void gather(Motion *x, Int hit)
{
    const Free *f = x->free;
    State *c = x->c;
    for (Int i = 0; i < f->m; i++)
        for (Int s = 1; s >= -1 && rigid(f, i) && i != hit && c->closed[i] == 0; s -= 2) {
            double g = stop_of(f, i, s), into = (double)s * position(x, i, 1);
            if (isinf(g) || !(into > 0.0) || (c->fresh_side[i] == s && c->fresh[i] > 0)) continue;
            if ((double)s * (g - position(x, i, 0)) > c->together * EPS * (c->t * into + 0.25 * fabs(g))) continue;
            c->closed[i] = s;
            note(x, i, REBOUND * s);
        }
}

/* The contacts that reach their stops leave them by Newton's law, all at once, and push those that are closed at rest. */
static void rebound(Motion *x, Int hit)
{
    const Free *f = x->free;
    State *c = x->c;
    if (c->begun > 1) gather(x, hit);
    outward(x, x->v);
    double size = 0.0;
    for (Int i = 0; i < f->m; i++) {
        int struck = i == hit || (c->closed[i] != 0 && c->side[i] == 0 && x->v[i] < 0.0);
        x->b[i] = struck ? x->v[i] : 0.0; /* the speed of those at rest is rounding */
        if (struck) size = most(size, fabs(x->v[i]));
    }
    c->fastest = most(c->fastest, size);
    double *before = x->v + f->m; /* blow and push change v and b */
    for (Int i = 0; i < f->m; i++) {
        before[i] = x->b[i];
        x->r[i] = (1.0 + most(0.0, f->laws[3 * i + 2])) * before[i];
    }
    push(x, 0);
    blow(x);
    Int *struck_side = x->at; /* which stops close, while contacts leave them */
    memcpy(struck_side, c->closed, (size_t)f->m * sizeof(Int));
    for (Int i = 0; i < f->m; i++)
        if (c->closed[i] != 0) {
            double v = before[i]; /* of one at rest not the rounding of its speed */
            for (Int j = 0; j < f->m; j++)
                if (x->P[j] != 0.0) v += (double)(c->closed[i] * struck_side[j]) * f->meet[i * f->m + j] * x->P[j];
            if (x->P[i] > 0.0) v = 0.0;
            if (before[i] < 0.0 && x->P[i] > 0.0) v = -f->laws[3 * i + 2] * before[i]; /* exactly */
            if (v > 1e-15 * size) {
                c->side[i] = 0, c->fresh[i] = 1, c->fresh_side[i] = c->closed[i], c->speed[i] = v;
                c->closed[i] = 0;
            }
        }
}

/* Term k of the series of a closed contact's gap; zero where it is the rounding of what cancels in it. */
static double gap_term(const Motion *x, Int i, int k)
{
    const Free *f = x->free;
    const Series *s = &x->s;
    Int n = f->n, m = f->m;
    double terms = 0.0, gap = -(double)x->c->closed[i] * s->u[k * m + i];
    for (Int j = 0; j < n; j++) {
        double drag = f->coupling == 1 ? fabs(f->drag[j]) : f->coupling == 2 ? fabs(f->damping[j * n + j]) : 0.0;
        double older = fabs(s->a[j]), size = fabs(s->a[n + j]);
        for (int l = 2; l <= k; l++) {
            double sum = f->w2[j] * older + drag * (l - 1.0) * size;
            for (Int other = 0; other < m; other++) sum += fabs(f->rows[other * n + j] * s->lam[(l - 2) * m + other]);
            older = size, size = sum / (l * (l - 1.0)) + fabs(s->a[l * n + j]);
        }
        terms += fabs(f->rows[i * n + j]) * size;
    }
    return fabs(gap) > 16.0 * EPS * terms ? gap : 0.0;
}

/* Number of the first term of the series of a closed contact's gap, at rest, that is not zero; 0 if it does not open. */
static int opens(const Motion *x, Int i)
{
    int k = 2;
    while (k < x->full && gap_term(x, i, k) == 0.0) k++;
    return gap_term(x, i, k) > 0.0 ? k : 0;
}

/* Newton's law at contact `hit`, -1 for none, and the closed ones at rest, which are held where they press. */
static void strike(Motion *x, Int hit)
{
    const Free *f = x->free;
    State *c = x->c;
    Int m = f->m, left = 0;
    drive_series(f, c->t, c->piece, x->full, x->s.G);
    if (hit >= 0) rebound(x, hit);
    for (Int i = 0; i < m; i++)
        if (c->closed[i] != 0) c->side[i] = 0, left++;
    if (left == 0) return;
    expand_here(x, x->full); /* without reactions: those that do not go into their stops leave, */
    double size = 0.0;
    for (int k = 2; k < 5 && size == 0.0; k++) /* by the first derivative that decides */
        for (Int i = 0; i < m; i++) {
            x->r[i] = gap_term(x, i, k);
            size += fabs(x->r[i]);
        }
    push(x, 0);
    for (Int i = 0; i < m; i++) c->side[i] = c->closed[i] != 0 && x->P[i] > 0.0 ? c->closed[i] : c->side[i];
    expand_here(x, x->full); /* those without a reaction stay where their gaps do not open beside these */
    for (Int i = 0; i < m; i++)
        if (c->closed[i] != 0) {
            int first = x->P[i] > 0.0 ? 0 : opens(x, i);
            c->side[i] = first ? 0 : c->closed[i], c->fresh[i] = first;
            c->fresh_side[i] = c->closed[i], c->speed[i] = 0.0;
        }
}

/* A contact that has just left its stop, and that the last blows drive back into it; -1 for none. The speeds of the
 * others are those behind the blows. left: the contacts that had left before. */
static Int driven_back(Motion *x, const Int *left)
{
    State *c = x->c;
    for (Int i = 0; i < x->free->m; i++) {
        if (!left[i] || c->closed[i] != 0 || c->side[i] != 0) continue;
        double v = -(double)left[i] * position(x, i, 1), old = c->fresh[i] == 1 ? c->speed[i] : 0.0;
        if (fabs(v - old) <= rate_rounding(x, i)) continue;
        if (v < 0.0) return i;
        c->fresh[i] = 1, c->fresh_side[i] = left[i], c->speed[i] = v;
    }
    return -1;
}

/* Speeds and derivatives at which gaps open, put aside while `driven_back` looks, and back. */
static void keep_gaps(Motion *x)
{
    memcpy(x->b, x->c->speed, (size_t)x->free->m * sizeof(double));
    memcpy(x->on, x->c->fresh, (size_t)x->free->m * sizeof(Int));
}

static void restore_gaps(Motion *x)
{
    memcpy(x->c->speed, x->b, (size_t)x->free->m * sizeof(double));
    memcpy(x->c->fresh, x->on, (size_t)x->free->m * sizeof(Int));
}

/* If contact `hit` chatters to rest in so short a time that acceleration and its rate are all there is, its speed is
 * taken at once, and it is held; unless another contact that moves it is hit before the last of these impacts. */
static void chatter(Motion *x, Int hit)
{
    const Free *f = x->free;
    State *c = x->c;
    Int m = f->m;
    double e = f->laws[3 * hit + 2], v = c->speed[hit], stop = (double)c->fresh_side[hit], after = 0.0, first = v;
    expand_here(x, x->full);
    double pull = 2.0 * stop * x->s.u[2 * m + hit], rise = 6.0 * stop * x->s.u[3 * m + hit];
    if (!(pull > 0.0 && 2.0 * v < most(CHATTER * least(1.0 / fastest(f, c), c->t) * pull * (1.0 - e), 2.0 * rate_rounding(x, hit)))) return;
    while (v > 1e-18 * first) {
        double s = 2.0 * v / (0.5 * pull + sqrt(most(0.25 * pull * pull + 2.0 / 3.0 * v * rise, 0.0)));
        v = e * (pull * s + 0.5 * rise * s * s - v);
        pull += rise * s;
        after += s;
    }
    Int blows = x->out->blows, coupled = 0;
    memcpy(x->turned, c->rate, (size_t)f->n * sizeof(double));
    c->side[hit] = c->fresh_side[hit], c->fresh[hit] = 0;
    close_held(x, hit, c->side[hit]);
    for (Int i = 0; i < m; i++) coupled |= i != hit && f->meet[hit * m + i] != 0.0;
    halt(x);
    keep_gaps(x);
    int another = driven_back(x, x->left) >= 0;
    if (!another) {
        expand_here(x, x->full);
        Event next = watch(f, x->full, after, c, &x->s);
        another = next.contact >= 0 && c->side[next.contact] == 0;
    }
    if (coupled && another) { /* impact by impact, then */
        restore_gaps(x);
        memcpy(c->rate, x->turned, (size_t)f->n * sizeof(double));
        x->out->blows = blows, c->side[hit] = c->closed[hit] = 0, c->fresh[hit] = 1;
    }
}

/* ------------------------------------------------------------------ the motion */

/* Contacts that are on or beyond their stops at the start. Returns 1 if rigid ones wait for `strike`. A derivative
 * below the rounding of its terms counts as zero. */
static int start(Motion *x, Int *hit)
{
    const Free *f = x->free;
    State *c = x->c;
    Int n = f->n, m = f->m;
    int waits = 0;
    expand_here(x, x->full);
    *hit = -1;
    for (Int i = 0; i < m; i++)
        for (Int s = 1; s >= -1; s -= 2) {
            double g = stop_of(f, i, s), depth = (double)s * (x->s.u[i] - g), into = (double)s * x->s.u[m + i], size = fabs(g);
            int first = 1;
            for (Int j = 0; j < n; j++) size = most(size, fabs(f->rows[i * n + j] * c->eta[j]));
            if (isinf(g) || depth < -4.0 * EPS * size) continue;
            if (fabs(depth) > 4.0 * EPS * size) {
                c->side[i] = depth * f->laws[3 * i] + f->laws[3 * i + 1] * into > 0.0 ? s : 2 * s;
                continue;
            }
            for (;;) {
                if (fabs(into) > 16.0 * EPS * terms_of(f, i, x->s.a + first * n) || first == 8) break;
                into = (double)s * x->s.u[++first * m + i];
            }
            c->fresh[i] = first, c->fresh_side[i] = s;
            if (first == 8 && !rigid(f, i)) c->slack[i] = 1e-300;
            if (!rigid(f, i)) {
                c->side[i] = into > 0.0 ? s : 0;
                if (into > 0.0 && f->laws[3 * i + 1] > 0.0) c->fresh[i] = first - 1;
            } else if (first == 1 && into <= 0.0) c->speed[i] = -into;
            else {
                c->closed[i] = s, waits = 1;
                if (first == 1) *hit = i;
            }
        }
    return waits;
}

/* The contact of an event changes its side; true where a rigid stop is struck, which waits for `strike`. */
static int change(Motion *x, Event e, Int *now)
{
    const Free *f = x->free;
    State *c = x->c;
    Int hit = e.contact, was = c->side[hit], stop = e.side > 0 ? 1 : -1;
    int dash = f->laws[3 * hit + 1] != 0.0;
    c->fresh_side[hit] = stop;
    if (rigid(f, hit)) {
        c->late = 0.0;
        memset(c->lost, 0, (size_t)(2 * f->n) * sizeof(double));
        if (was == 0) {
            close_held(x, hit, stop);
            *now = REBOUND * stop;
            return 1;
        }
        c->side[hit] = 0, c->fresh[hit] = 3; /* held, and presses no more */
    } else if (was == 0) c->side[hit] = stop, c->fresh[hit] = !dash;
    else if (was == 1 || was == -1) c->side[hit] = dash ? 2 * stop : 0, c->fresh[hit] = 1;
    else c->side[hit] = e.side == 2 || e.side == -2 ? 0 : stop, c->fresh[hit] = 1;
    *now = c->side[hit];
    return 0;
}

static void mark(Motion *x)
{
    const State *c = x->c;
    Output *o = x->out;
    Int n = x->free->n, m = x->free->m, k = o->marks++;
    o->mark_t[k] = c->t;
    memcpy(o->mark_eta + k * n, c->eta, (size_t)n * sizeof(double));
    memcpy(o->mark_rate + k * n, c->rate, (size_t)n * sizeof(double));
    memcpy(o->mark_side + k * m, c->side, (size_t)m * sizeof(Int));
    x->c->since = 0;
}

/* Contacts that throw each other off at one time, ever more slowly, come to rest: true if that is so. */
static int rest(Motion *x, Int hit)
{
    const Free *f = x->free;
    State *c = x->c;
    if (hit < 0 || c->still <= TURNS) return 0;
    drive_series(f, c->t, c->piece, x->full, x->s.G);
    outward(x, x->v);
    if (!(fabs(x->v[hit]) < 1e-12 * c->fastest)) return 0;
    for (Int i = 0; i < f->m; i++)
        if (x->left[i] != 0) c->closed[i] = x->left[i], c->fresh[i] = 0;
    halt(x);
    strike(x, -1);
    return 1;
}

/* Marks the contacts that have just left their stops. */
static void mark_left(Motion *x)
{
    State *c = x->c;
    for (Int i = 0; i < x->free->m; i++)
        x->left[i] = rigid(x->free, i) && c->side[i] == 0 && c->closed[i] == 0 && c->fresh[i] > 0 ? c->fresh_side[i] : 0;
}

/* Impacts of the contacts that had left, and that blows drive back. */
static void strike_again(Motion *x)
{
    State *c = x->c;
    for (Int back; (back = driven_back(x, x->left)) >= 0;) {
        x->left[back] = 0, c->fresh[back] = 0;
        close_held(x, back, c->fresh_side[back]);
        note(x, back, REBOUND * c->fresh_side[back]);
        strike(x, back);
    }
}

/* Impacts that wait act; the side of contact `hit` is that behind them. */
static void act(Motion *x)
{
    const Free *f = x->free;
    State *c = x->c;
    Output *o = x->out;
    Int hit = c->hit, last = o->events - 1;
    mark_left(x);
    if (!rest(x, hit)) strike(x, hit);
    strike_again(x);
    Int count = o->events;
    for (Int k = c->begun > 1 && hit >= 0 ? last : count; k < count; k++) {
        Int i = o->event_contact[k];
        if (c->side[i] != 0 || c->closed[i] != 0 || c->fresh[i] != 1 || f->laws[3 * i + 2] >= 1.0) continue;
        mark_left(x);
        x->left[i] = 0;
        chatter(x, i);
    }
    if (c->begun > 1 && hit >= 0) /* the event and those that were gathered behind it */
        for (Int k = last; k < o->events; k++) {
            Int i = o->event_contact[k];
            o->event_side[k] = c->side[i] != 0 ? c->side[i] : REBOUND * c->fresh_side[i];
        }
    c->waits = 0;
    if (f->m < 2) return;
    mark_left(x); /* one that left twice may have been driven back twice: its turn comes at the same time */
    keep_gaps(x);
    Int back = driven_back(x, x->left);
    restore_gaps(x);
    if (back >= 0) c->waits = 2, c->hit = back;
}

/* The impact of a contact that blows have driven back is the next event. */
static void turn_of(Motion *x, Int i)
{
    State *c = x->c;
    close_held(x, i, c->fresh_side[i]);
    c->fresh[i] = 0, c->waits = 1, c->still++;
    note(x, i, REBOUND * c->fresh_side[i]);
}

/* Rounding of the position of a contact in a stretch of length h. */
static double rounding(const Motion *x, Int i, Int side, double h)
{
    const Free *f = x->free;
    double stop = side ? fabs(stop_of(f, i, side)) : 0.0;
    return ROUNDINGS * EPS * (stop + terms_of(f, i, x->c->eta) + terms_of(f, i, x->c->rate) * h) + 1e-300;
}

/* Whether a spring's contact at its stop turns back before it has passed it by more than `lost`: no event. */
static int grazes(Motion *x, Event e, double lost)
{
    const Free *f = x->free;
    State *c = x->c;
    Int m = f->m, i = e.contact;
    if (rigid(f, i) || c->slack[i] > 0.0 || f->laws[3 * i + 1] != 0.0) return 0;
    double way = e.side > 0 ? 1.0 : -1.0, sign = c->side[i] == 0 ? -way : way;
    expand_here(x, 3);
    double rate = sign * x->s.u[m + i], turns = 2.0 * sign * x->s.u[2 * m + i];
    return turns > 0.0 && rate * rate <= 2.0 * turns * lost;
}

/* A contact whose events do not let time advance moves by rounding alone: these events are none. */
static void still_contact(Motion *x, Int i)
{
    Output *o = x->out;
    x->c->slack[i] = rounding(x, i, x->c->fresh_side[i], 0.0);
    while (o->events >= 2 && o->event_contact[o->events - 1] == i && o->event_contact[o->events - 2] == i
           && o->event_t[o->events - 2] == x->c->t)
        o->events -= 2;
}

/* Contacts that have left their stops by more than rounding are followed as all others again. */
static void wake(Motion *x)
{
    const Free *f = x->free;
    State *c = x->c;
    for (Int i = 0; i < f->m; i++) {
        if (!(c->slack[i] > 0.0)) continue;
        double nearest = INFINITY;
        drive_series(f, c->t, c->piece, 1, x->s.G);
        for (Int s = 0; s < 2; s++) nearest = least(nearest, fabs(position(x, i, 0) - f->stops[2 * i + s]));
        if (nearest > 4.0 * (rounding(x, i, 0, 0.0) + c->slack[i])) c->slack[i] = 0.0;
    }
}

static Int run(Motion *x)
{
    const Free *f = x->free;
    State *c = x->c;
    Output *o = x->out;
    Int n = f->n;
    if (!c->begun) {
        room_for(x, x->t_end); /* moves on to the piece at t */
        c->waits = start(x, &c->hit), c->begun = 1;
        if (!c->waits) mark(x);
    }
    while (c->t < x->t_end) {
        if (c->waits == 2) turn_of(x, c->hit);
        if (c->waits) act(x), mark(x);
        else if (c->since >= BETWEEN) mark(x);
        /* room for all of the next turn, whose impacts come before this line */
        if (o->marks + 2 > o->room || o->events + 4 * f->m * f->m + 2 > o->room || o->blows + 8 * f->m * f->m > o->room) return FULL;
        c->begun = 2, c->since++;
        if (c->still > STILL) return STALLED;
        if (c->waits) continue;
        int K = 0;
        const Free *flown;
        double h = begin(x, room_for(x, x->t_end), &flown, &K);
        Event e;
        if (flown) {
            see(flown, c->t, &x->g);
            e = flight(flown, &x->g, h, c);
        } else {
            c->leap = 0.0, c->evaluations++;
            e = watch(f, K, h, c, &x->s);
        }
        for (; o->station < o->n_stations; o->station++) { /* one at an event has the state behind it */
            double end = c->t + (e.s - c->late); /* as `move` rounds it */
            if (e.contact < 0 ? o->stations[o->station] > end : o->stations[o->station] >= end) break;
            double tau = o->stations[o->station] - c->t;
            state_at(x, flown, K, tau, o->eta_at + o->station * n, o->rate_at + o->station * n);
            forces_at(x, flown, K, tau, o->force_at + o->station * f->m);
        }
        for (Int i = 0; i < f->m; i++) c->size[i] = most(c->size[i], rounding(x, i, 0, e.s));
        double before = c->t, lost = e.contact < 0 ? 0.0 : c->size[e.contact] + ROUNDINGS * EPS * fabs(stop_of(f, e.contact, e.side));
        move(x, flown, K, e.s);
        c->still = c->t == before ? c->still + 1 : 0;
        if (c->still == 0) memset(c->fresh, 0, (size_t)f->m * sizeof(Int));
        wake(x);
        if (!isfinite(c->t) || !isfinite(dot(c->eta, c->eta, n)) || !isfinite(dot(c->rate, c->rate, n))) return NOT_FINITE;
        if (c->still > STILL) return STALLED;
        if (e.contact < 0) continue;
        c->leap = 0.0;
        if (grazes(x, e, lost)) {
            c->slack[e.contact] = lost;
            continue;
        }
        c->hit = e.contact, c->size[e.contact] = 0.0;
        Int side;
        c->waits = change(x, e, &side);
        note(x, c->hit, side);
        if (!c->waits) c->since = BETWEEN; /* a mark behind every event */
        if (c->still > LOOSE && !rigid(f, c->hit)) still_contact(x, c->hit);
    }
    return DONE;
}

/* Every array of a call in one block: called with NULL it returns the size, else it deals the block out. */
static size_t layout(Motion *x, double *block)
{
    const Free *f = x->free;
    Int n = f->n, m = f->m, B = 2 * f->F + f->R, N = f->N, T, at = 0;
    if (n > N) N = n;
    if (f->up && f->up->N > N) N = f->up->N;
    if (f->low && f->low->N > N) N = f->low->N;
    T = N + f->F;
#define REALS(name, count) (name = block ? block + at : NULL, at += (count))
#define INTS(name, count) (name = block ? (Int *)(block + at) : NULL, at += (count))
    REALS(x->turned, n), REALS(x->turned_rate, n);
    REALS(x->s.a, MOST * n), REALS(x->s.u, MOST * m), REALS(x->s.lam, MOST * m), REALS(x->s.G, MOST * B);
    INTS(x->s.held, m), REALS(x->s.inverse, m * m), REALS(x->s.A, m * m);
    REALS(x->g.z, 2 * N), REALS(x->g.poly, 2 * N * ROOM), INTS(x->g.degree, N), REALS(x->g.Z, 2 * m * T), REALS(x->g.slide, m * ROOM);
    REALS(x->g.sizes, m * T), REALS(x->g.C, T), REALS(x->g.S, T), REALS(x->g.x, T), REALS(x->g.y, T), REALS(x->g.h, 2 * n);
    REALS(x->g.c, 4 * f->R);
    REALS(x->P, m), REALS(x->r, m), REALS(x->v, 2 * m), REALS(x->b, m), REALS(x->inward, m);
    INTS(x->on, m), INTS(x->at, m), INTS(x->left, m);
    x->law = block ? (Law *)(block + at) : NULL, at += m * (Int)(sizeof(Law) / sizeof(double));
    return (size_t)(at + node_memory(&x->node, m, block ? block + at : NULL)) * sizeof(double);
}

/* The memory of a call; NULL without any. */
static double *prepared(Motion *x)
{
    const Free *f = x->free;
    double *block = calloc(1, layout(x, NULL) + 1);
    if (!block) return NULL;
    layout(x, block);
    x->full = terms_for(RADIANS);
    Int T = f->N + f->F;
    x->free_fast = T ? f->sorted[3 * T - 1] : 0.0;
    return block;
}

Int exact_follow(const Free *f, State *state, double t_end, Output *out)
{
    Motion x = {.free = f, .c = state, .t_end = t_end, .out = out};
    double *block = prepared(&x);
    if (!block) return NO_MEMORY;
    Int result = run(&x);
    free(block);
    return result;
}

/* ------------------------------------------------------------------ the motion again, from its marks */

static void restore(Motion *x, Int k, const Marks *marks)
{
    State *c = x->c;
    Int n = x->free->n, m = x->free->m;
    c->t = marks->t[k], c->late = 0.0, c->piece = 0;
    Int lo = 0, hi = x->free->E; /* the piece by bisection; room_for goes on from there */
    while (hi - lo > 1) {
        Int middle = (lo + hi) / 2;
        if (x->free->edges[middle] <= c->t) lo = middle;
        else hi = middle;
    }
    c->piece = lo;
    memcpy(c->eta, marks->eta + k * n, (size_t)n * sizeof(double));
    memcpy(c->rate, marks->rate + k * n, (size_t)n * sizeof(double));
    memcpy(c->side, marks->side + k * m, (size_t)m * sizeof(Int));
    memset(c->lost, 0, (size_t)(2 * n) * sizeof(double));
}

Int exact_read(const Free *f, State *c, const Marks *marks, Int count, const double *times, const Int *mark_of,
               double *eta_at, double *rate_at, double *force_at)
{
    Motion x = {.free = f, .c = c};
    double *block = prepared(&x);
    Int n = f->n, m = f->m, result = block ? DONE : NO_MEMORY;
    for (Int i = 0; result == DONE && i < count;) {
        Int last = i;
        while (last + 1 < count && mark_of[last + 1] == mark_of[i]) last++;
        restore(&x, mark_of[i], marks);
        while (i <= last) {
            int K = 0;
            const Free *flown;
            double h = begin(&x, most(room_for(&x, times[last]), 1e-300), &flown, &K), until = c->t + h;
            if (until == c->t) until = times[i]; /* roundings of the time are left */
            for (; i <= last && times[i] <= until; i++) {
                double tau = most(0.0, times[i] - c->t);
                state_at(&x, flown, K, tau, eta_at + i * n, rate_at + i * n);
                forces_at(&x, flown, K, tau, force_at + i * m);
            }
            if (i <= last) move(&x, flown, K, h);
        }
    }
    free(block);
    return result;
}

/* Coefficients of a polynomial in s - a. */
static void shifted(double *p, int n, double a)
{
    for (int k = 0; k < n && a != 0.0; k++)
        for (int l = n - 1; l >= k; l--) p[l] += a * p[l + 1];
}

/* The largest value, if above `best`, of a force on [0, h], a polynomial of degree n, whose integral is added. */
static double press_on(const double *p, int n, double h, double best, double *impulse)
{
    double total = 0.0;
    for (int l = n; l >= 0; l--) total = total * h + p[l] / (l + 1.0);
    *impulse += total * h;
    return highest(p, n, h, best);
}

/* The same of the only contact, a spring, in a flight over [a, b]: series of the terms that have not decayed yet. */
static double press_in_flight(Motion *x, const Free *f, Int side, double a, double b, double best, double *impulse)
{
    Flight *g = &x->g;
    Int T = g->T, alive = T;
    int K = terms_for(RADIANS);
    double kappa = x->free->laws[0], p[MOST + 1], rest, size = 0.0;
    if (K < g->deg) K = (int)g->deg;
    for (Int k = 0; k < T; k++) size += g->sizes[k];
    while (a < b) {
        waves_at(f->sorted, f->sorted + T, T, f->damped, T ? f->sorted[3 * T - 1] : 0.0, a, g->C, g->S);
        while (alive && g->sizes[alive - 1] * hypot(g->C[alive - 1], g->S[alive - 1]) < 1e-18 * size) alive--;
        double fast = alive ? f->sorted[2 * T + alive - 1] : 0.0, h = least(b - a, RADIANS / most(fast, 1e-300));
        gap_series(f, g, 0, a, alive, K, p, &rest);
        p[0] -= stop_of(f, 0, side);
        for (int k = 0; k <= K; k++) p[k] *= (double)side * kappa;
        best = press_on(p, K, h, best, impulse);
        a += h;
    }
    return best;
}

Int exact_press(const Free *f, State *c, const Marks *marks, Int contact, Int count, const double *starts,
                const double *ends, double *peak, double *impulse)
{
    Motion x = {.free = f, .c = c};
    double *block = prepared(&x), p[MOST + 1];
    Int m = f->m, k = 0, result = block ? DONE : NO_MEMORY;
    for (Int i = 0; result == DONE && i < count; i++) {
        while (k + 1 < marks->count && marks->t[k + 1] <= starts[i]) k++;
        peak[i] = impulse[i] = 0.0;
        for (Int at = k; at < marks->count && (at == k || marks->t[at] < ends[i]); at++) {
            double until = at + 1 < marks->count ? least(ends[i], marks->t[at + 1]) : ends[i];
            Int side = marks->side[at * m + contact];
            if ((side != 1 && side != -1) || until <= starts[i]) continue;
            restore(&x, at, marks);
            while (c->t < until) {
                int K = 0;
                const Free *flown;
                double h = begin(&x, room_for(&x, until), &flown, &K), way = (double)side;
                double a = most(0.0, starts[i] - c->t), b = least(h, until - c->t);
                if (c->t + h == c->t) break;
                if (a < b && flown) {
                    see(flown, c->t, &x.g);
                    peak[i] = press_in_flight(&x, flown, side, a, b, peak[i], impulse + i);
                } else if (a < b) {
                    int degree = rigid(f, contact) ? K - 2 : K - 1;
                    for (int l = 0; l <= degree; l++)
                        p[l] = way * (rigid(f, contact) ? -x.s.lam[l * m + contact] : spring_term(f, &x.s, l, contact, side));
                    shifted(p, degree, a);
                    peak[i] = press_on(p, degree, b - a, peak[i], impulse + i);
                }
                move(&x, flown, K, h);
            }
        }
    }
    free(block);
    return result;
}
