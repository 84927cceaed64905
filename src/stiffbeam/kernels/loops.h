/* The loops that take the time of the march. Sums that may be taken in any order say so (omp simd): no -ffast-math,
 * which would drop NaN and infinite stops. */
#ifndef STIFFBEAM_LOOPS_H
#define STIFFBEAM_LOOPS_H

#include "law.h"
#include <stdlib.h>
#include <string.h>

#ifndef HOT
#define HOT /* what a compiler needs to make several versions of a loop for several processors */
#endif
#ifdef __GNUC__
#define LOOP __attribute__((unused)) static
#else
#define LOOP static
#endif

/* out += c rows: eight rows at a time, so that `out` is loaded and stored once for all of them. */
HOT LOOP void add_rows(double *restrict out, Int n, const double *restrict c, const double *restrict rows, Int wide,
                       Int count)
{
    Int i = 0;
    for (; i + 8 <= count; i += 8, c += 8, rows += 8 * wide) {
        const double *restrict r = rows, *restrict q = rows + 4 * wide;
        double c0 = c[0], c1 = c[1], c2 = c[2], c3 = c[3], c4 = c[4], c5 = c[5], c6 = c[6], c7 = c[7];
        for (Int j = 0; j < n; j++)
            out[j] += ((c0 * r[j] + c1 * r[wide + j]) + (c2 * r[2 * wide + j] + c3 * r[3 * wide + j])) +
                      ((c4 * q[j] + c5 * q[wide + j]) + (c6 * q[2 * wide + j] + c7 * q[3 * wide + j]));
    }
    for (; i + 4 <= count; i += 4, c += 4, rows += 4 * wide) {
        double c0 = c[0], c1 = c[1], c2 = c[2], c3 = c[3];
        for (Int j = 0; j < n; j++)
            out[j] += (c0 * rows[j] + c1 * rows[wide + j]) + (c2 * rows[2 * wide + j] + c3 * rows[3 * wide + j]);
    }
    for (; i + 2 <= count; i += 2, c += 2, rows += 2 * wide) {
        double c0 = c[0], c1 = c[1];
        for (Int j = 0; j < n; j++) out[j] += c0 * rows[j] + c1 * rows[wide + j];
    }
    if (i < count)
        for (Int j = 0; j < n; j++) out[j] += c[0] * rows[j];
}

/* new[d] = sum_e T[e][d] z[e n + d]. */
HOT LOOP void turn(const double *restrict T, Int a, Int n, Int D, const double *restrict z, double *restrict new)
{
    Int e = a % 2 ? 1 : 2;
    if (a % 2)
        for (Int d = 0; d < D; d++) new[d] = T[d] * z[d];
    else
        for (Int d = 0; d < D; d++) new[d] = T[d] * z[d] + T[D + d] * z[n + d];
    for (; e < a; e += 2) {
        const double *restrict one = T + e * D, *restrict at = z + e * n;
        for (Int d = 0; d < D; d++) new[d] += one[d] * at[d] + one[D + d] * at[n + d];
    }
}

/* Long ones in four parts, since one sum waits for its own additions. */
HOT LOOP double dot(const double *restrict x, const double *restrict y, Int n)
{
    double s = 0.0, t = 0.0, u = 0.0, v = 0.0;
    Int part = n < 64 ? 0 : n / 16 * 4;
#pragma omp simd reduction(+ : s, t, u, v)
    for (Int j = 0; j < part; j++) { /* none of a short one */
        s += x[j] * y[j], t += x[part + j] * y[part + j];
        u += x[2 * part + j] * y[2 * part + j], v += x[3 * part + j] * y[3 * part + j];
    }
#pragma omp simd reduction(+ : s)
    for (Int j = 4 * part; j < n; j++) s += x[j] * y[j];
    return (s + t) + (u + v);
}

/* Eight rows, `wide` apart, on one vector, which is loaded once for all of them. */
HOT LOOP void dots(const double *restrict rows, Int wide, const double *restrict x, Int n, double *restrict out)
{
    const double *restrict r = rows, *restrict q = rows + 4 * wide;
    double s0 = 0.0, s1 = 0.0, s2 = 0.0, s3 = 0.0, t0 = 0.0, t1 = 0.0, t2 = 0.0, t3 = 0.0;
#pragma omp simd reduction(+ : s0, s1, s2, s3, t0, t1, t2, t3)
    for (Int j = 0; j < n; j++) {
        double p = x[j];
        s0 += r[j] * p, s1 += r[wide + j] * p, s2 += r[2 * wide + j] * p, s3 += r[3 * wide + j] * p;
        t0 += q[j] * p, t1 += q[wide + j] * p, t2 += q[2 * wide + j] * p, t3 += q[3 * wide + j] * p;
    }
    out[0] = s0, out[1] = s1, out[2] = s2, out[3] = s3, out[4] = t0, out[5] = t1, out[6] = t2, out[7] = t3;
}

HOT LOOP void add(double *restrict y, const double *restrict x, double factor, Int n)
{
    for (Int j = 0; j < n; j++) y[j] += factor * x[j];
}

/* How many of u are beyond their bounds, without a branch. */
static inline Int beyond(const double *restrict u, const double *restrict low, const double *restrict high, Int n)
{
    Int count = 0;
    for (Int j = 0; j < n; j++) count += (u[j] > high[j]) | (u[j] < low[j]);
    return count;
}

/* Memory of `count` numbers at a 64-byte boundary; `block` is for free(). NULL where there is none. */
static inline double *aligned(Int count, void **block)
{
    *block = calloc((size_t)count + 8, sizeof(double));
    return *block ? (double *)(((uintptr_t)*block + 63) / 64 * 64) : NULL;
}

#endif
