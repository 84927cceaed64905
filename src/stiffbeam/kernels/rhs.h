/* The equations of an adaptive solver for Python, SUNDIALS and other programs: one description of every argument.
 *
 *     E y' = A y + sum_k g_k(t) load_k + sum_c F_c push_c,  n unknowns y, m contacts,
 *     g = (1, sin w_1 t, cos w_1 t, ..., R records, functions that the caller evaluates),  d functions of time.
 *
 * z (size,) is y and the integrals of the energy balance: input, viscous loss, -F of every contact and, with damped
 * stops, the energy that these absorb. Matrices are row by row. Sizes are checked once, in Python.
 */
#ifndef STIFFBEAM_RHS_H
#define STIFFBEAM_RHS_H

#include "law.h"

/* Sparse rows: entries k of row i have starts[i] <= k < starts[i + 1]. */
typedef struct {
    const Int *starts SHAPE(rows), *columns OR_NULL(count);
    const double *entries OR_NULL(count);
} Rows;

#define THROUGH 2 /* the regime of a contact that follows its law; otherwise the side that presses, 0 where it is open */

typedef struct {
    Int n, m, size, d, F, R, P, N, damped, viscous, inertia; /* the last two: whether D and E have entries */
    Int first, stride; /* where SUNDIALS stores entry (i, j) of a Jacobian: first + i + j stride */
    Rows A, D, E;      /* (n, n); y^T D y is the viscous power; (size, size), or none for the identity */
    const double *frequencies SHAPE(F), *edges SHAPE(N), *records SHAPE(N, R, P); /* polynomials from one edge on */
    const double *loads SHAPE(d, n), *power SHAPE(d, n), *offsets SHAPE(d, m); /* power: the loads on the velocities */
    const double *pushes SHAPE(m, n), *positions SHAPE(m, n), *velocities SHAPE(m, n);
    const double *accelerations SHAPE(m, n); /* on E y' */
    const Law *law SHAPE(m, 6);
    /* What a solver sets from phase to phase. */
    const double *lengths SHAPE(m), *levels SHAPE(roots); /* of a contact's motion; what event functions count as zero */
    const Int *regime SHAPE(m);
    const double *window SHAPE(2);        /* where records hold */
    const double *given SHAPE(3, called); /* functions of the caller, with two derivatives */
} Equations;

/* z' (size,). */
API void state_rate(double t, const double *y, double *out, const Equations *e);
API void right_hand_side(double t, const double *z, double *out, const Equations *e);
/* J[first + i + j stride] += cj E_ij + sign df_i/dz_j, the rows of the integrals left as they are. */
API void jacobian(double t, const double *z, double cj, double sign, double *J, Int first, Int stride,
                  const Equations *e);
/* u - g2 and g1 - u of every stop, > 0 in it, then their rates, less the levels. Of a damped stop, instead of its gap,
 * what is > 0 where it presses: the lesser of gap and force, as a length. With one among the stops a third row follows:
 * the rates of the forces of the damped ones, else of the gaps. */
API void event_functions(double t, const double *z, double *out, const Equations *e);

#endif
