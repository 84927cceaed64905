/* The contacts of one node together, see node.h; the law of one of them is in law.h. */
#include "node.h"
#include "loops.h"
#include "march.h"

Int node_memory(Node *x, Int m, double *at)
{
    double **places[] = {&x->F, &x->r, &x->w, &x->before, &x->f, &x->tolerance, &x->trial, &x->trial_f, &x->step};
    double **squares[] = {&x->S, &x->S_rate, &x->J, &x->J_trial};
    Int used = 0;
    for (size_t i = 0; i < sizeof places / sizeof *places; i++, used += m) *places[i] = at ? at + used : NULL;
    for (size_t i = 0; i < sizeof squares / sizeof *squares; i++, used += m * m) *squares[i] = at ? at + used : NULL;
    x->which = at ? (Int *)(at + used) : NULL;
    return used + m;
}

/* x with A x = b in place of b, with row exchanges; 0 where a pivot is zero. */
int eliminate(double *A, double *b, Int n)
{
    for (Int k = 0; k < n; k++) {
        Int p = k;
        for (Int i = k + 1; i < n; i++)
            if (fabs(A[i * n + k]) > fabs(A[p * n + k])) p = i;
        if (!(fabs(A[p * n + k]) > 0.0)) return 0;
        for (Int j = k; j < n; j++) {
            double x = A[k * n + j];
            A[k * n + j] = A[p * n + j], A[p * n + j] = x;
        }
        double x = b[k];
        b[k] = b[p], b[p] = x;
        for (Int i = k + 1; i < n; i++) {
            double share = A[i * n + k] / A[k * n + k];
            for (Int j = k + 1; j < n; j++) A[i * n + j] -= share * A[k * n + j];
            b[i] -= share * b[k];
        }
    }
    for (Int i = n - 1; i >= 0; i--) {
        for (Int k = i + 1; k < n; k++) b[i] -= A[i * n + k] * b[k];
        b[i] /= A[i * n + i];
    }
    return 1;
}

/* Springs, or rigid stops. Contacts that pull, or are open and penetrate, change all at once while their number falls
 * (Judice and Pires), else the first alone (Murty's rule, which ends for a compliance whose principal minors are
 * positive, symmetric or not). The diagonal grows by a rounding, so that of equal rows each has a share. */
void solve_springs(const double *r, const double *S, Int wide, const Law *law, Int m, Node *x)
{
    double *force = x->F, *right = x->trial, *side = x->step, *next = x->f, *A = x->J;
    Int fewest = m + 1, chances = 3;
    for (Int c = 0; c < m; c++) force[c] = side[c] = 0.0;
    for (Int round = 0; round < 20 * m * m; round++) {
        Int wrong = 0, closed = 0;
        for (Int c = 0; c < m; c++) {
            double v = r[c], size = fabs(v);
            for (Int e = 0; e < m; e++) v += S[e * wide + c] * force[e], size += fabs(S[e * wide + c] * force[e]);
            if (side[c] != 0.0) next[c] = force[c] * side[c] < 0.0 ? side[c] : 0.0; /* the force opposes its side */
            else if (most(v - law[c].g2, law[c].g1 - v) > 1e-15 * size) next[c] = v > law[c].g2 ? 1.0 : -1.0;
            else next[c] = 0.0; /* open, but for rounding */
            wrong += next[c] != side[c];
        }
        if (!wrong) return;
        chances = wrong < fewest ? 3 : chances - 1;
        fewest = wrong < fewest ? wrong : fewest;
        for (Int c = 0, changes = 0; c < m; c++) {
            if (next[c] != side[c] && (chances >= 0 || changes++ == 0)) side[c] = next[c];
            force[c] = 0.0;
            if (side[c] != 0.0) x->which[closed++] = c;
        }
        for (Int i = 0; i < closed; i++) {
            Int c = x->which[i];
            right[i] = (side[c] > 0.0 ? law[c].g2 : law[c].g1) - r[c];
            for (Int j = 0; j < closed; j++) A[i * closed + j] = S[x->which[j] * wide + c];
            A[i * closed + i] = A[i * closed + i] * (1.0 + 1e-15) + 1.0 / law[c].kappa;
        }
        eliminate(A, right, closed);
        for (Int i = 0; i < closed; i++) force[x->which[i]] = right[i];
    }
}

/* f(F): each contact alone, the others' forces given; its slopes; returns |F - f|^2. */
static double each_alone(const Node *x, Int rule, const Law *law, Int m, const double *F, double *f, double *J)
{
    double total = 0.0;
    for (Int c = 0; c < m; c++) {
        const double *S = x->S + c * m, *S_rate = x->S_rate + c * m;
        double here = x->r[c], rate = x->w[c], size = fabs(here), size_rate = fabs(rate);
        for (Int e = 0; e < m; e++)
            if (e != c) {
                here += S[e] * F[e], size += fabs(S[e] * F[e]);
                rate += S_rate[e] * F[e], size_rate += fabs(S_rate[e] * F[e]);
            }
        Response a = force_alone(here, rate, S[c], S_rate[c], x->before[c], rule, law + c);
        f[c] = a.F;
        x->tolerance[c] = 16.0 * 2.3e-16 * (fabs(a.F) + fabs(a.dr) * size + fabs(a.dw) * size_rate); /* of rounding */
        for (Int e = 0; e < m; e++) J[c * m + e] = e == c ? 1.0 : -a.dr * S[e] - a.dw * S_rate[e];
        total += (F[c] - a.F) * (F[c] - a.F);
    }
    return total;
}

/* Any law: a semismooth Newton method on H = F - f(F) with a line search on |H|; where that does not lower |H|, and
 * after 50 steps, every contact takes its own f_c in turn. NaN where the search fails. */
void solve_laws(Node *x, Int rule, const Law *law, Int m)
{
    double *F = x->F, *f = x->f, *trial = x->trial, *trial_f = x->trial_f, *J = x->J, *J_trial = x->J_trial, *t;
    int coupled = 0;
    for (Int c = 0; c < m; c++) F[c] = 0.0, coupled |= damps(law + c);
    for (Int c = 0; c < m * m; c++) coupled |= x->S[c] != 0.0;
    double merit = each_alone(x, rule, law, m, F, f, J);
    for (int k = 0; k < 2000; k++) {
        int done = 1, lowered = 0;
        if (coupled && !isfinite(merit)) break;
        for (Int c = 0; c < m; c++) done &= fabs(F[c] - f[c]) <= x->tolerance[c];
        if (done || !coupled) { /* where no force changes another f is the solution */
            if (f != x->F) memcpy(x->F, f, (size_t)m * sizeof *f);
            return;
        }
        double new = merit, share = 1.0;
        for (Int c = 0; c < m; c++) x->step[c] = F[c] - f[c];
        if (k < 50 && eliminate(J, x->step, m))
            for (int i = 0; i < 6 && !lowered; i++, share *= 0.5) { /* Armijo's rule */
                for (Int c = 0; c < m; c++) trial[c] = F[c] - share * x->step[c];
                new = each_alone(x, rule, law, m, trial, trial_f, J_trial);
                lowered = new < (1.0 - 1e-4 * share) * merit;
            }
        if (!lowered) {
            memcpy(trial, F, (size_t)m * sizeof *F);
            for (Int c = 0; c < m; c++) {
                const double *S = x->S + c * m, *S_rate = x->S_rate + c * m;
                double here = x->r[c], rate = x->w[c];
                for (Int e = 0; e < m; e++)
                    if (e != c) here += S[e] * trial[e], rate += S_rate[e] * trial[e];
                trial[c] = force_alone(here, rate, S[c], S_rate[c], x->before[c], rule, law + c).F;
            }
            new = each_alone(x, rule, law, m, trial, trial_f, J_trial);
        }
        t = F, F = trial, trial = t, t = f, f = trial_f, trial_f = t, t = J, J = J_trial, J_trial = t, merit = new;
    }
    for (Int c = 0; c < m; c++) x->F[c] = NAN;
}

/* ------------------------------------------------------------------ for Python */

API Int solve_node(Int m, const double *r, const double *S, const Law *law, double *F)
{
    Node x = {0};
    double *memory = calloc((size_t)node_memory(&x, m, NULL) + 1, sizeof *memory);
    if (!memory) return NO_MEMORY;
    node_memory(&x, m, memory);
    solve_springs(r, S, m, law, m, &x);
    memcpy(F, x.F, (size_t)m * sizeof *F);
    free(memory);
    return DONE;
}

API void contact_forces(Int count, const double *u, const double *v, const Law *law, double *F, double *energy)
{
    for (Int i = 0; i < count; i++) F[i] = law_force(u[i], v[i], law + i);
    for (Int i = 0; energy && i < count; i++) energy[i] = stored(depth(u[i], law + i), law + i);
}
