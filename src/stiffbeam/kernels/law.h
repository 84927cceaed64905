/* The contact law:  F = -(f(d) (1 + lambda d') + c d')_+,  f = kappa d^p,  d = u - g2 > 0, mirrored below.
 *
 * A new term is a field of Law, a change of the functions under "the terms", and one of their slopes, here and in rhs.c.
 * Then one contact at a node: u = r + s F, u' = w + s' F with F after the law, or with the mean of the elastic force over
 * the step (the discrete gradient). model/contact.py is the same for NumPy and JAX; a test compares the two.
 */
#ifndef STIFFBEAM_LAW_H
#define STIFFBEAM_LAW_H

#include <math.h>
#include <stdint.h>

#ifdef _WIN32
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

typedef int64_t Int;

/* The shape of an array, row by row, for library.py, which reads the structures in these headers: sizes are numbers,
 * fields, and sums of products of these. OR_NULL: an array that may be None. C has no use for them. */
#define SHAPE(...)
#define OR_NULL(...)

/* A row of Python's array of laws: stiffness, lower and upper stop, exponent, dashpot, Hunt and Crossley's coefficient.
 */
typedef struct {
    double kappa, g1, g2, p, c, lam;
} Law;

/* A force and its slopes in r and w. */
typedef struct {
    double F, dr, dw;
} Response;

/* A node's force: of springs in closed form, of any law, or its mean over the step. */
enum Rule { LINEAR, BY_LAW, MEAN };

#define NEWTON 200 /* iterations at most, of which a handful are used */

static inline double least(double x, double y) { return x < y ? x : y; }
static inline double most(double x, double y) { return x > y ? x : y; }

/* ------------------------------------------------------------------ the terms */

/* d^p; Hertz' law by a square root. */
static inline double power(double d, double p)
{ return p == 1.0 ? d : p == 1.5 ? d * sqrt(d) : p == 0.5 ? sqrt(d) : p == 2.5 ? d * d * sqrt(d) : pow(d, p); }

static inline double elastic(double d, const Law *l) { return l->kappa * copysign(power(fabs(d), l->p), d); }
static inline double elastic_slope(double d, const Law *l)
{ return l->p == 1.0 ? l->kappa : l->kappa * l->p * power(fabs(d), l->p - 1.0); }

static inline double stored(double d, const Law *l)
{ return l->p == 1.0 ? 0.5 * l->kappa * d * d : l->kappa * power(fabs(d), l->p + 1.0) / (l->p + 1.0); }

static inline double pressure(double d, double rate, const Law *l)
{ return elastic(d, l) * (1.0 + l->lam * rate) + l->c * rate; }
static inline int is_affine(const Law *l) { return l->p == 1.0 && l->lam == 0.0; }
static inline int jumps(const Law *l) { return l->c > 0.0; }
static inline int damps(const Law *l) { return l->c > 0.0 || l->lam > 0.0; }

/* (U(d1) - U(d0))/(d1 - d0) of two depths > 0, without cancellation: the powers' difference by expm1 and log1p. */
static inline double mean_elastic(double d0, double d1, const Law *l)
{
    double p = l->p, share = (d1 - d0) / d0;
    if (p == 1.0) return l->kappa * 0.5 * (d0 + d1);
    if (fabs(share) < 1e-12) return l->kappa * power(d0, p) * (1.0 + 0.5 * p * share);
    return l->kappa * power(d0, p) * expm1((p + 1.0) * log1p(share)) / ((p + 1.0) * share);
}

/* ------------------------------------------------------------------ between two stops */

/* +1 beyond g2, -1 beyond g1, else 0. */
static inline double side_of(double u, const Law *l) { return u > l->g2 ? 1.0 : u < l->g1 ? -1.0 : 0.0; }
/* > 0 into the upper stop, < 0 into the lower. */
static inline double depth(double u, const Law *l) { return u > l->g2 ? u - l->g2 : u < l->g1 ? u - l->g1 : 0.0; }

/* F(u, u'). */
static inline double law_force(double u, double v, const Law *l)
{
    double side = side_of(u, l);
    return side == 0.0 ? 0.0 : -side * most(0.0, pressure(fabs(depth(u, l)), side * v, l));
}

/* F at the end of a step whose node found `node_force`, NaN for none. Where F jumps, at the stop, the state does not
 * tell it. */
static inline double force_of_node(double u, double v, double node_force, const Law *l)
{ return isnan(node_force) || !jumps(l) ? law_force(u, v, l) : node_force; }

/* The side on which the stop presses there, 0 where it does not. */
static inline double side_of_node(double u, double v, double node_force, const Law *l)
{
    if (!isnan(node_force) && jumps(l)) return node_force == 0.0 ? 0.0 : copysign(1.0, -node_force);
    double side = side_of(u, l);
    return side == 0.0 || !damps(l) || pressure(fabs(depth(u, l)), side * v, l) > 0.0 ? side : 0.0;
}

/* ------------------------------------------------------------------ one contact at a node, after the law */

/* Of a spring: |F| over the depth that there is without it. */
static inline double spring_stiffness(double s, const Law *l) { return l->kappa / (1.0 + l->kappa * s); }

/* (P, slopes) with P = |F|(d0 - s P, d0' - s' P): the force P moves the node back by s P. |F| grows with d and d', so
 * there is one P. Affine: one division. Else Newton's method in a bracket. Where c > 0, |F| jumps at d = 0, and the P
 * that holds the node there, d0/s, may lie within the jump. */
static inline Response solve_pressure(double d0, double rate0, double s, double s_rate, const Law *l)
{
    double P = pressure(d0, rate0, l), slope = elastic_slope(d0, l) * (1.0 + l->lam * rate0),
           slope_rate = elastic(d0, l) * l->lam + l->c;
    if (P <= 0.0) return (Response){0.0, 0.0, 0.0};
    if (is_affine(l)) {
        double below = 1.0 + slope * s + slope_rate * s_rate;
        P /= below, slope /= below, slope_rate /= below;
    } else {
        double left = 0.0, right = s * P > d0 ? d0 / s : P; /* a larger force would move the node off the stop */
        P = 0.0;
        for (int i = 0; i < NEWTON; i++) {
            double d = d0 - s * P, rate = rate0 - s_rate * P, trial = pressure(d, rate, l);
            slope = elastic_slope(d, l) * (1.0 + l->lam * rate), slope_rate = elastic(d, l) * l->lam + l->c;
            double below = 1.0 + s * slope + s_rate * slope_rate;
            slope /= below, slope_rate /= below;
            if (trial > P)
                left = P; /* |F| at the trial falls as P grows */
            else
                right = P;
            double new = P + (trial - P) / below, old = P;
            P = left <= new && new <= right ? new : 0.5 * (left + right);
            if (fabs(P - old) <= 2e-16 * P || left >= right) break;
        }
    }
    return s * P >= d0 ? (Response){d0 / s, 1.0 / s, 0.0} : (Response){P, slope, slope_rate};
}

static inline Response stage_force(double r, double w, double s, double s_rate, const Law *l)
{
    double side = side_of(r, l);
    if (side == 0.0) return (Response){0.0, 0.0, 0.0};
    Response x = solve_pressure(fabs(depth(r, l)), side * w, s, s_rate, l);
    return (Response){-side * x.F, -x.dr, -x.dw};
}

/* ------------------------------------------------------------------ one contact, its mean force over a step from u0 */

/* (U(u) - U(u0))/(u - u0). */
static inline double secant(double u, double u0, const Law *l)
{
    double a = depth(u0, l), b = depth(u, l);
    if (a > 0.0 && b > 0.0) return mean_elastic(a, b, l);
    if (a < 0.0 && b < 0.0) return -mean_elastic(-a, -b, l);
    return u == u0 ? elastic(a, l) : (stored(b, l) - stored(a, l)) / (u - u0);
}

/* d secant/du, to what Newton's method needs. */
static inline double secant_slope(double u, double u0, double slope, const Law *l)
{
    if (fabs(u - u0) > 1e-7 * (fabs(u) + fabs(u0))) return most(0.0, (elastic(depth(u, l), l) - slope) / (u - u0));
    double d = fabs(depth(0.5 * (u + u0), l)); /* the quotient loses its digits as the ends meet: U''/2 */
    return d > 0.0 ? 0.5 * elastic_slope(d, l) : 0.0;
}

static inline Response mean_force(double r, double u0, double s, const Law *l)
{
    double slope = secant(r, u0, l), sign = copysign(1.0, slope), left = 0.0, right = fabs(slope), P = 0.0;
    if (slope == 0.0) return (Response){0.0, 0.0, 0.0};
    for (int i = 0; i < NEWTON; i++) {
        double u = r - sign * s * P, value = sign * secant(u, u0, l), old = P;
        if (value > P)
            left = P;
        else
            right = P;
        double new = P + (value - P) / (1.0 + s * secant_slope(u, u0, sign * value, l));
        P = left <= new && new <= right ? new : 0.5 * (left + right);
        if (fabs(P - old) <= 2e-16 * P || left >= right) break;
    }
    double F = -sign * P;
    double stiff = secant_slope(r + s * F, u0, -F, l);
    return (Response){F, -stiff / (1.0 + s * stiff), 0.0};
}

static inline Response force_alone(double r, double w, double s, double s_rate, double u0, Int rule, const Law *l)
{ return rule == MEAN ? mean_force(r, u0, s, l) : stage_force(r, w, s, s_rate, l); }

#endif
