/* Right-hand side, residual, Jacobian and event functions, and the same as CVODE and IDA call them. */
#include "rhs.h"
#include "loops.h"

/* The functions of time (order 0), their rates or accelerations. */
static void functions(double t, int order, double *g, const Equations *e)
{
    *g++ = order == 0;
    for (Int k = 0; k < e->F; k++) {
        double w = e->frequencies[k], s = sin(w * t), c = cos(w * t);
        *g++ = order == 0 ? s : order == 1 ? w * c : -w * w * s;
        *g++ = order == 0 ? c : order == 1 ? -w * s : -w * w * c;
    }
    if (e->R) {
        /* Within the window. At its end the polynomial before it holds. */
        double inside = most(e->window[0], least(t, e->window[1])), before = nextafter(e->window[1], -INFINITY);
        Int low = 0, high = e->N - 1;
        while (high - low > 1) {
            Int middle = (low + high) / 2;
            if (e->edges[middle] <= least(inside, before))
                low = middle;
            else
                high = middle;
        }
        double s = inside - e->edges[low];
        for (Int r = 0; r < e->R; r++) {
            const double *c = e->records + (low * e->R + r) * e->P;
            double value = 0.0;
            for (Int p = e->P - 1; p >= order; p--)
                value = value * s + c[p] * (double)(order == 0 ? 1 : order == 1 ? p : p * (p - 1));
            *g++ = value;
        }
    }
    Int given = e->d - 1 - 2 * e->F - e->R;
    memcpy(g, e->given + order * given, (size_t)given * sizeof(double));
}

static double row_of(const Rows *S, Int i, const double *x)
{
    double total = 0.0;
    for (Int k = S->starts[i]; k < S->starts[i + 1]; k++) total += S->entries[k] * x[S->columns[k]];
    return total;
}

/* A contact point relative to its stops. */
typedef struct {
    double u, v, rate; /* rate: the offset's part of v */
    double side;       /* on which it presses, by its regime or its law */
} Motion;

static Motion motion(Int c, const double *y, const double *g, const double *g_rate, const Equations *e)
{
    Motion x = {0.0, 0.0, 0.0, 0.0};
    for (Int k = 0; k < e->d; k++) x.u += e->offsets[k * e->m + c] * g[k], x.rate += e->offsets[k * e->m + c] * g_rate[k];
    x.u += dot(e->positions + c * e->n, y, e->n);
    x.v = x.rate + dot(e->velocities + c * e->n, y, e->n);
    x.side = e->regime[c] == THROUGH ? side_of_node(x.u, x.v, NAN, &e->law[c]) : (double)e->regime[c];
    return x;
}

/* Depth into the stop on a side, smooth across it. */
static double depth_on(double side, double u, const Law *l) { return side > 0.0 ? u - l->g2 : l->g1 - u; }

/* y' and, unless that is NULL, the rates of the integrals. */
static void rates(double t, const double *y, double *out, double *integrals, const Equations *e)
{
    Int n = e->n, m = e->m;
    double g[e->d], g_rate[e->d], input = 0.0, viscous = 0.0, absorbed = 0.0;
    functions(t, 0, g, e), functions(t, 1, g_rate, e);
    for (Int i = 0; i < n; i++) out[i] = row_of(&e->A, i, y);
    for (Int k = 0; k < e->d; k++)
        for (Int i = 0; i < n; i++) out[i] += e->loads[k * n + i] * g[k];
    for (Int c = 0; c < m; c++) {
        const Law *l = &e->law[c];
        Motion x = motion(c, y, g, g_rate, e);
        double F = x.side == 0.0 ? 0.0 : -x.side * pressure(depth_on(x.side, x.u, l), x.side * x.v, l);
        if (F != 0.0)
            for (Int i = 0; i < n; i++) out[i] += e->pushes[c * n + i] * F;
        input -= F * x.rate;
        if (damps(l)) absorbed -= F * x.v;
        if (integrals) integrals[2 + c] = -F;
    }
    if (!integrals) return;
    for (Int k = 0; k < e->d; k++) input += g[k] * dot(e->power + k * n, y, n);
    if (e->viscous)
        for (Int i = 0; i < n; i++) viscous += y[i] * row_of(&e->D, i, y);
    integrals[0] = input, integrals[1] = viscous;
    if (e->damped) integrals[2 + m] = absorbed;
}

void state_rate(double t, const double *y, double *out, const Equations *e) { rates(t, y, out, NULL, e); }
void right_hand_side(double t, const double *z, double *out, const Equations *e) { rates(t, z, out, out + e->n, e); }

/* E z' - f(t, z). */
static void residual(double t, const double *z, const double *rate, double *out, const Equations *e)
{
    right_hand_side(t, z, out, e);
    for (Int i = 0; i < e->size; i++) out[i] = (e->inertia ? row_of(&e->E, i, rate) : rate[i]) - out[i];
}

static void add_sparse(const Rows *S, Int n, double factor, double *J, Int stride)
{
    for (Int i = 0; i < n; i++)
        for (Int k = S->starts[i]; k < S->starts[i + 1]; k++) J[i + S->columns[k] * stride] += factor * S->entries[k];
}

void jacobian(double t, const double *z, double cj, double sign, double *J, Int first, Int stride, const Equations *e)
{
    Int n = e->n;
    double g[e->d], g_rate[e->d];
    if (e->inertia) add_sparse(&e->E, e->size, cj, J + first, stride);
    add_sparse(&e->A, n, sign, J + first, stride);
    functions(t, 0, g, e), functions(t, 1, g_rate, e);
    for (Int c = 0; c < e->m; c++) {
        const Law *l = &e->law[c];
        Motion x = motion(c, z, g, g_rate, e);
        if (x.side == 0.0) continue;
        double d = depth_on(x.side, x.u, l), to_u = elastic_slope(fabs(d), l) * (1.0 + l->lam * x.side * x.v),
               to_v = elastic(d, l) * l->lam + l->c;
        for (Int j = 0; j < n; j++) {
            double slope = to_u * e->positions[c * n + j] + to_v * e->velocities[c * n + j];
            if (slope == 0.0) continue;
            for (Int i = 0; i < n; i++) /* a band has no place for the zeros outside it */
                if (e->pushes[c * n + i] != 0.0) J[first + i + j * stride] -= sign * e->pushes[c * n + i] * slope;
        }
    }
}

/* The acceleration of contact c relative to its stops. */
static double acceleration(Int c, double t, const double *y, const Equations *e)
{
    double rate[e->n], g[e->d], total = 0.0;
    rates(t, y, rate, NULL, e), functions(t, 2, g, e);
    for (Int k = 0; k < e->d; k++) total += e->offsets[k * e->m + c] * g[k];
    return total + dot(e->accelerations + c * e->n, rate, e->n);
}

/* A length with the sign of the pressure at d > 0, smooth across the stop: its root is where a stop lets go. */
static double pull(double d, double rate, double length, const Law *l)
{
    return jumps(l) ? pressure(d, rate, l) / (elastic(length, l) / length) : length * (1.0 + l->lam * rate);
}

void event_functions(double t, const double *z, double *out, const Equations *e)
{
    double g[e->d], g_rate[e->d];
    Int sides = 0, k = 0;
    for (Int c = 0; c < e->m; c++) sides += isfinite(e->law[c].g2) + isfinite(e->law[c].g1);
    functions(t, 0, g, e), functions(t, 1, g_rate, e);
    for (Int c = 0; c < e->m; c++) {
        const Law *l = &e->law[c];
        Motion x = motion(c, z, g, g_rate, e);
        double bend = damps(l) ? acceleration(c, t, z, e) : 0.0;
        for (double side = 1.0; side >= -1.0; side -= 2.0) {
            if (!isfinite(side > 0.0 ? l->g2 : l->g1)) continue;
            double gap = depth_on(side, x.u, l), rate = side * x.v;
            out[k] = gap, out[sides + k] = rate;
            if (e->damped) out[2 * sides + k] = rate;
            if (damps(l)) { /* it lets go before its gap opens */
                out[k] = least(gap, pull(gap, rate, e->lengths[c], l));
                out[2 * sides + k] = elastic_slope(fabs(gap), l) * (1.0 + l->lam * rate) * rate +
                                     (elastic(gap, l) * l->lam + l->c) * side * bend;
            }
            k++;
        }
    }
    for (k = 0; k < (e->damped ? 3 : 2) * sides; k++) out[k] -= e->levels[k];
}

/* ------------------------------------------------------------------ as CVODE and IDA call them
 *
 * SUNDIALS hands over vectors and matrices as structures whose first member is the address of a content. Word VECTOR,
 * DENSE or BAND of that is the address of the numbers, which Python verifies with the functions of the library. */

enum { VECTOR = 1, DENSE = 1, BAND = 3 };

static double *numbers(void *structure, int word) { return (*(double ***)structure)[word]; }

static int fill(double t, void *z, void *matrix, double cj, double sign, const Equations *e)
{
    int word = e->stride == e->size ? DENSE : BAND;
    jacobian(t, numbers(z, VECTOR), cj, sign, numbers(matrix, word), e->first, e->stride, e); /* of zeros as it comes */
    return 0;
}

API int cvode_right_hand_side(double t, void *z, void *rate, void *e)
{
    right_hand_side(t, numbers(z, VECTOR), numbers(rate, VECTOR), e);
    return 0;
}

API int cvode_jacobian(double t, void *z, void *rate, void *matrix, void *e, void *a, void *b, void *c)
{
    (void)rate, (void)a, (void)b, (void)c;
    return fill(t, z, matrix, 0.0, 1.0, e);
}

API int cvode_events(double t, void *z, double *out, void *e)
{
    event_functions(t, numbers(z, VECTOR), out, e);
    return 0;
}

API int ida_residual(double t, void *z, void *rate, void *out, void *e)
{
    residual(t, numbers(z, VECTOR), numbers(rate, VECTOR), numbers(out, VECTOR), e);
    return 0;
}

API int ida_jacobian(double t, double cj, void *z, void *rate, void *out, void *matrix, void *e, void *a, void *b,
                     void *c)
{
    (void)rate, (void)out, (void)a, (void)b, (void)c;
    return fill(t, z, matrix, cj, -1.0, e);
}

API int ida_events(double t, void *z, void *rate, double *out, void *e)
{
    (void)rate;
    event_functions(t, numbers(z, VECTOR), out, e);
    return 0;
}
