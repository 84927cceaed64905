/* Functions of the march for Python: one description of every argument. Matrices are row by row; (M, m) is a shape.
 *
 * Sizes are checked once, in Python; nothing here checks them. No function keeps anything between calls, so that
 * threads may call any of them at the same time. Functions that need memory return NO_MEMORY where there is none.
 */
#ifndef STIFFBEAM_MARCH_H
#define STIFFBEAM_MARCH_H

#include "law.h"

enum { NO_MEMORY = -1, LIST_IS_FULL = 0, DONE = 1 };

/* ---------------------------------------------------------------- blocks of steps */

/* K steps of a scheme as one linear map.
 *
 * A state of a components and n modes, D = a n numbers, is held as z (D + (a - 1) n,): its components, then all but the
 * last once more, so that z[e n + d] is what is e components after z[d]. The block gives R entries (positions at all
 * nodes first, then those at ends of steps that are no node, then velocities at nodes where a force depends on them)
 * and the D numbers of the new state. */
typedef struct {
    Int R, D, N, a, n;           /* entries, state, forces (nodes rounded up to a multiple of 8), components, modes */
    Int C, K, nodes;             /* channels, steps, forces that there are: K times stages times contacts */
    Int rule, rated;             /* enum Rule; 1 where forces depend on velocities */
    const double *reading SHAPE(D, R);
    const double *transition SHAPE(a, D); /* z_new[d] = sum_e transition[e][d] z[e n + d] */
    const double *push SHAPE(N, R + D);   /* of a unit force on entries and new state */
    const Int *end_first SHAPE(C);        /* the entry that holds a channel at the end of the first step, */
    const Int *end_stride SHAPE(C);       /* and how many entries later the next one is */
    const Int *rates OR_NULL(N);          /* the entry that holds the velocity at a node; NULL unless rated */
} Block;

/* Response of a block to the drive g = (1, sin w1 t, cos w1 t, ..) at its start, d = 1 + 2 F numbers. */
typedef struct {
    Int F;
    double constant;           /* 1, or 0 where nothing is constant in time */
    const double *frequencies SHAPE(F);
    const double *rows SHAPE(1 + 2 F, R + D);
} Drive;

/* `steps` steps from step `first`. Arrays without const are written or advanced in place. */
typedef struct {
    Int m, W, first, steps;   /* contacts, numbers of x, range of steps */
    Int every, outputs, room; /* an output every so many steps; rows of outputs, 0 for none; rows of events */
    double dt;
    const Law *law SHAPE(m, 6);
    const double *effects SHAPE(C, K, W); /* of a block's x, see march.c, on the channels' velocities at the ends of steps */
    const double *inflow OR_NULL(B, R + D); /* share of sampled loads and offsets in every block */
    const double *inflow_velocity OR_NULL(B, C, K);
    double *z SHAPE(state);               /* D + (a - 1) n */
    double *position SHAPE(C), *velocity SHAPE(C); /* at the last step */
    double *tally SHAPE(m, 8);
    Int *diverged SHAPE(1); /* the step that overflowed, minus that whose forces were not found, 0 for none */
    double *times OR_NULL(outputs);
    double *positions OR_NULL(outputs, C), *velocities OR_NULL(outputs, C);
    double *node_forces OR_NULL(outputs, m);    /* of the nodes at the ends of steps */
    double *contact_forces OR_NULL(outputs, m); /* of linear stops */
    double *starts OR_NULL(B, state), *forces OR_NULL(B, N); /* for the energy balance */
    double *events SHAPE(room, 6); /* list of impacts */
    Int *cursor SHAPE(2);          /* block, free row of events: where the next call goes on */
} Run;

/* Columns of a contact's tally and of the list of impacts, see recorder.py. */
enum { SIDE, TOUCHING, PEAK, IMPULSE, ROW, SINCE, LAST, TALLY = 8 };
enum { CONTACT, TIME, STOP, IMPACT_PEAK, IMPACT_IMPULSE, END, EVENT };

/* DONE, or LIST_IS_FULL where the list of impacts may not hold another block's: call again with a longer one. */
API Int march(const Block *block, const Drive *drive, const Run *run);

/* Fraction of a step at which contact with the stop on `side` begins or ends, from both ends (u, u') of the step. */
API double switch_time(double u0, double v0, double u1, double v1, double side, const Law *law, double dt);

/* ---------------------------------------------------------------- states */

/* q and q' (2, 1 + steps, n) behind the first row, after single steps under known forces, every K from one of `starts`
 * (B, a n): transition as that of a Block, push (F, a n), forces (steps, F), memory z (3, a n). */
API void states(Int a, Int n, Int F, Int steps, Int K, const double *transition, const double *push,
                const double *forces, const double *starts, double *z, double *out);

/* ---------------------------------------------------------------- rigid stops */

enum { AT_A_STOP, WHERE_PREDICTED, WHERE_CLOSED }; /* when a node can press; the first in a position, else a velocity */

/* K steps on states of D numbers, with S nodes and m contacts. */
typedef struct {
    Int a, n, D, S, m, K;     /* a > 0: every mode steps by itself, D = a n */
    const double *blocks OR_NULL(a, a, n);
    const double *matrix OR_NULL(D, D);
    const double *reading SHAPE(S, m, D);       /* argument of each node from the old state */
    const double *predicting SHAPE(m, D);       /* predicted positions */
    const double *responses SHAPE(S, m, D);     /* of the new state to unit reactions */
    const double *compliance SHAPE(S, S, m, m); /* [node of the reaction, node of the argument, reaction, argument] */
    const Int *kinds SHAPE(S);
    const double *bounds SHAPE(S, m, 2);        /* where the stops stand in the arguments */
    const double *stops SHAPE(m, 2);            /* in positions */
    const double *driven SHAPE(K, D);           /* what loads add to the states, */
    const double *shifts SHAPE(K, S, m);        /* and with offsets to the arguments, */
    const double *predicted SHAPE(K, m);        /* and to predicted positions */
    double *z SHAPE(D);
    double *path SHAPE(K, D);                   /* states at the ends of the steps */
    double *reactions SHAPE(K, S, m);
} Rigid;

API Int rigid_steps(const Rigid *s);

/* ---------------------------------------------------------------- contacts of one node */

/* F (m,) of springs, or rigid stops, with v = r + S F; S (m, m) symmetric positive semidefinite. */
API Int solve_node(Int m, const double *r, const double *S, const Law *law, double *F);

/* Forces, and energies unless NULL, at positions u and velocities v, each (count,) as the laws are. */
API void contact_forces(Int count, const double *u, const double *v, const Law *law, double *F, double *energy);

#endif
