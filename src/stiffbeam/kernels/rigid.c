/* The steps of a scheme for rigid stops: a linear step, then the reactions node by node. */
#include "loops.h"
#include "march.h"
#include "node.h"

#define ON_STOP 1e-13 /* of the terms of a predicted position: so near a stop it is on it */

/* The position that node kinds WHERE_PREDICTED ask; what rounding takes from it does not open a resting contact. */
static double predicted_position(const Rigid *s, Int k, Int c)
{
    double total = s->predicted[k * s->m + c], size = fabs(total);
    for (Int d = 0; d < s->D; d++) {
        double term = s->predicting[c * s->D + d] * s->z[d];
        total += term, size += fabs(term);
    }
    for (Int side = 0; side < 2; side++) {
        double stop = s->stops[2 * c + side], off = fabs(total - stop);
        if (off < INFINITY && off <= ON_STOP * (size + fabs(stop))) total = stop;
    }
    return total;
}

API Int rigid_steps(const Rigid *s)
{
    Int m = s->m, S = s->S, D = s->D, n = s->n;
    Node x = {0};
    void *memory;
    /* Arguments of the nodes, predicted positions, reactions of the last node on a position; then laws of 6 numbers. */
    double *r = aligned((S + 8) * m + node_memory(&x, m, NULL), &memory), *before = r + S * m, *closed = before + m;
    if (!r) return NO_MEMORY;
    Law *law = (Law *)(closed + m);
    node_memory(&x, m, (double *)(law + m));
    for (Int k = 0; k < s->K; k++) {
        double *new = s->path + k * D;
        for (Int i = 0; i < S * m; i++) r[i] = s->shifts[k * S * m + i] + dot(s->reading + i * D, s->z, D);
        for (Int c = 0; c < m; c++) before[c] = predicted_position(s, k, c);
        memcpy(new, s->driven + k * D, (size_t)D * sizeof *new);
        for (Int i = 0; i < s->a; i++)
            for (Int e = 0; e < s->a; e++)
                for (Int j = 0; j < n; j++) new[i * n + j] += s->blocks[(i * s->a + e) * n + j] * s->z[e * n + j];
        for (Int i = 0; !s->a && i < D; i++) new[i] += dot(s->matrix + i * D, s->z, D);
        /* Node by node. One on the velocity may press only if its contact is closed. */
        for (Int node = 0; node < S; node++) {
            const double *own = s->compliance + (node * S + node) * m * m;
            double *reaction = s->reactions + (k * S + node) * m;
            int touched = 0;
            for (Int c = 0; c < m; c++) {
                double lower = s->bounds[2 * (node * m + c)], upper = s->bounds[2 * (node * m + c) + 1];
                if (s->kinds[node] == WHERE_PREDICTED) {
                    if (!(before[c] <= s->stops[2 * c])) lower = -INFINITY;
                    if (!(before[c] >= s->stops[2 * c + 1])) upper = INFINITY;
                } else if (s->kinds[node] == WHERE_CLOSED) {
                    if (!(closed[c] > 0.0)) lower = -INFINITY;
                    if (!(closed[c] < 0.0)) upper = INFINITY;
                }
                law[c] = (Law){.kappa = INFINITY, .g1 = lower, .g2 = upper};
                touched |= r[node * m + c] < lower || r[node * m + c] > upper;
                reaction[c] = 0.0;
            }
            if (touched) {
                solve_springs(r + node * m, own, m, law, m, &x);
                memcpy(reaction, x.F, (size_t)m * sizeof *reaction);
                add_rows(new, D, x.F, s->responses + node * m * D, D, m);
                for (Int later = node + 1; later < S; later++)
                    add_rows(r + later * m, m, x.F, s->compliance + (node * S + later) * m * m, m, m);
            }
            if (s->kinds[node] == AT_A_STOP) memcpy(closed, reaction, (size_t)m * sizeof *closed);
        }
        memcpy(s->z, new, (size_t)D * sizeof *new);
    }
    free(memory);
    return DONE;
}
