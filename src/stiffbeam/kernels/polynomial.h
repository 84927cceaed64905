/* Polynomials on an interval: their first zero, and their largest value, certified by Bernstein coefficients. */
#ifndef STIFFBEAM_POLYNOMIAL_H
#define STIFFBEAM_POLYNOMIAL_H

#include "law.h"
#include <string.h>

#define EPS  2.220446049250313e-16
#define MOST 44 /* coefficients, less one */

static inline double value(const double *p, int n, double s)
{
    double x = 0.0;
    for (int k = n; k >= 0; k--) x = x * s + p[k];
    return x;
}

/* Coefficients in s/h; returns the sum of their sizes. */
static inline double scaled(const double *p, int n, double h, double *out)
{
    double power = 1.0, size = 0.0;
    for (int k = 0; k <= n; k++, power *= h) {
        out[k] = p[k] * power;
        size += fabs(out[k]);
    }
    return size;
}

/* Coefficients to Bernstein's on [0, 1]: b_i = sum_j C(i, j)/C(n, j) p_j; all weights are below 1. */
static inline void bernstein(double *p, int n)
{
    for (int i = n; i > 0; i--) {
        double b = 0.0, c = 1.0;
        for (int j = 0; j <= i; j++) {
            b += c * p[j];
            c *= j < n ? (double)(i - j) / (n - j) : 0.0;
        }
        p[i] = b;
    }
}

/* b becomes the coefficients on the right half of its interval, left those on the left half: de Casteljau's rule. */
static inline void halve(double *b, int n, double *left)
{
    for (int r = 0; r <= n; r++) {
        left[r] = b[0];
        for (int i = 0; i < n - r; i++) b[i] = 0.5 * (b[i] + b[i + 1]);
    }
}

/* The only zero in [lo, hi], where p falls through zero: bisection, and Newton wherever it stays inside. */
static inline double only_zero(const double *p, int n, double lo, double hi)
{
    for (;;) {
        double x = 0.5 * (lo + hi), y = 0.0, slope = 0.0;
        for (int k = n; k >= 0; k--) {
            slope = slope * x + y;
            y = y * x + p[k];
        }
        if (y > 0.0) lo = x;
        else hi = x;
        if (slope < 0.0 && lo < x - y / slope && x - y / slope < hi) {
            x -= y / slope;
            y = value(p, n, x);
            double width = most(4.0 * fabs(y / slope), 2.0 * EPS * x); /* the zero is within, most likely */
            if (y > 0.0) {
                lo = x;
                if (value(p, n, least(hi, x + width)) <= 0.0) hi = least(hi, x + width);
            } else {
                hi = x;
                if (value(p, n, most(lo, x - width)) > 0.0) lo = most(lo, x - width);
            }
        }
        if (hi - lo <= 4.0 * EPS * hi) return hi;
    }
}

/* The first s in (0, h] at which a polynomial of `size` coefficients that starts positive turns negative; -1 for none.
 * The first `zeros` coefficients are zero exactly. A start below zero by rounding counts as zero if it rises.
 * The signs of the Bernstein coefficients tell how often it may cross; halves are looked at until none or one is left. */
static inline double first_zero(const double *given, int size, double h, int zeros)
{
    double all[MOST + 1], *p = all, stack[64][MOST + 1], ends[64][2], low;
    int n = size - zeros - 1, top = 0;
    if (n < 0) return -1.0;
    double sum = scaled(given + zeros, n, h, p);
    for (int first = zeros == 0; n > 0 && (p[0] == 0.0 || (first && p[0] < 0.0 && p[1] > 0.0)); first = 0, p++, n--) {}
    if (p[0] < 0.0) return 0.0;
    low = p[0];
    for (int k = 1; k <= n; k++) low += least(0.0, p[k]);
    if (low >= 0.0) return -1.0;
    while (n > 0 && fabs(p[n]) <= 1e-18 * sum) n--; /* what is below rounding need not be converted */
    memcpy(stack[0], p, (size_t)(n + 1) * sizeof *p);
    bernstein(stack[0], n);
    ends[0][0] = 0.0, ends[0][1] = 1.0;
    while (top >= 0) {
        double *b = stack[top], lo = ends[top][0], hi = ends[top][1], middle = 0.5 * (lo + hi);
        int changes = 0;
        for (int i = 0; i < n; i++) changes += (b[i] > 0.0) != (b[i + 1] > 0.0);
        if (changes == 0 && b[0] > 0.0) {
            top--;
            continue;
        }
        if (changes <= 1 || hi - lo < 1e-13 || top > 60) return h * only_zero(p, n, lo, hi); /* Descartes */
        halve(b, n, stack[++top]); /* the left half is above the right one on the stack */
        ends[top][0] = lo, ends[top][1] = middle, ends[top - 1][0] = middle;
    }
    return -1.0;
}

/* The largest value, if above `best`, of a polynomial on [0, h]. */
static inline double highest(const double *given, int n, double h, double best)
{
    double stack[64][MOST + 1], *p = stack[0], bend = 0.0, end = 0.0, bound = 0.0;
    int top = 0;
    scaled(given, n, h, p);
    for (int k = n; k >= 0; k--) end += p[k], bound += k ? most(0.0, p[k]) : p[0], bend += k > 1 ? k * fabs(p[k]) : 0.0;
    if (bound <= best) return best;
    if (n > 0 && fabs(p[1]) > bend) return most(best, most(p[0], end)); /* it only rises, or only falls */
    bernstein(p, n);
    while (top >= 0) {
        double *b = stack[top], most_of_all = b[0], size = 0.0;
        for (int i = 0; i <= n; i++) most_of_all = most(most_of_all, b[i]), size = most(size, fabs(b[i]));
        best = most(best, most(b[0], b[n])); /* the values at the ends */
        if (most_of_all <= best + 4.0 * EPS * size || top > 60) {
            top--;
            continue;
        }
        halve(b, n, stack[++top]);
    }
    return best;
}

#endif
