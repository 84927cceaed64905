/* The contacts of one node together: u = r + S F, u' = w + S' F, every F_c after its own law. */
#ifndef STIFFBEAM_NODE_H
#define STIFFBEAM_NODE_H

#include "law.h"

/* What is asked at a node of m contacts, and memory. All are (m,), matrices (m, m); F is the answer. */
typedef struct {
    double *F, *r, *w, *before, *S, *S_rate; /* before: positions at the start of the step */
    double *f, *tolerance, *trial, *trial_f, *step, *J, *J_trial;
    Int *which;
} Node;

/* Places in memory `at`, none in NULL; returns its length in numbers. */
Int node_memory(Node *x, Int m, double *at);

/* x with A x = b in place of b; 0 where a pivot is zero. */
int eliminate(double *A, double *b, Int n);

/* Forces of springs, or rigid stops, from r; S[e * wide + c]: of a force at e on c. */
void solve_springs(const double *r, const double *S, Int wide, const Law *law, Int m, Node *x);

/* Forces under any law from r, w, S, S_rate and before of x; S[c * m + e]. NaN where the search fails. */
void solve_laws(Node *x, Int rule, const Law *law, Int m);

#endif
