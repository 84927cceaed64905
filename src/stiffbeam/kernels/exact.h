/* Exact motion, event by event. Matrices are row by row.
 *
 * Sizes: n modes, m contacts, F frequencies (the first is 0: constants), R records, E edges of the records' pieces,
 * N exponentials of the modes, B = 2 F + R rows of loads, T = N + F terms of a motion in closed form.
 * Sides of a contact: 0 open, +-1 pressed or held at the upper/lower stop, +-2 beyond a damped stop that has let go;
 * an event that throws a contact back has REBOUND times the stop.
 */
#ifndef STIFFBEAM_EXACT_H
#define STIFFBEAM_EXACT_H

#include "law.h"

enum { NO_MEMORY = -1, DONE, FULL, STALLED, NOT_FINITE }; /* results of exact_follow */
enum { REBOUND = 9 };

/* The free system in its modes, and its contacts. */
typedef struct Free {
    Int n, m, F, R, E, N;
    Int coupling; /* of the damping: 0 none, 1 diagonal, 2 full */
    Int kind;     /* of flight: 0 none, 1 real pairs (N = n), 2 complex modes */
    Int damped;   /* 1 if a pole has a real part */
    const struct Free *up, *low; /* with the only contact pressed at the upper, lower stop, in the modes V eta; NULL for none */
    double decay, stiffest, fastest_wave; /* bounds of the damping, of the squared frequencies, of the drives */
    double longest; /* flight: inverse of the fastest rate of the modes that are `apart`; else infinity */
    const double *w2 SHAPE(n);            /* squared frequencies */
    const double *drag SHAPE(n);          /* diagonal of the damping */
    const double *damping SHAPE(n, n);
    const double *rows SHAPE(m, n);
    const double *stops SHAPE(m, 2);      /* lower, upper; infinite for none */
    const double *laws SHAPE(m, 3);       /* stiffness (infinite: rigid), damping, restitution */
    const double *meet SHAPE(m, m);       /* rows rows^T */
    const double *loads SHAPE(2 F + R, n); /* of sin and cos of every frequency, then of the records */
    const double *offsets SHAPE(2 F + R, m); /* of the stops */
    const double *waves SHAPE(F);         /* frequencies */
    const double *edges SHAPE(E);
    const double *pieces SHAPE(E, R, 4);  /* cubics of the records in the time since each edge */
    const double *poles SHAPE(2, N + F);  /* sigma and omega of the modes' exponentials, then of the frequencies */
    const double *sorted SHAPE(3, N + F); /* sigma, omega and size, from slow to fast */
    const double *answer SHAPE(2 F, n);   /* particular solution of sin and cos */
    const double *out OR_NULL(4, n, N);   /* eta = out[0] x - out[1] y, eta' = out[2] x - out[3] y of modes x + iy; kind 2 */
    const double *back OR_NULL(2, N, 2 n); /* x and y of (eta, eta'); kind 2 */
    const double *seen OR_NULL(2, m, N);  /* x and -y as the contacts see them */
    const Int *order SHAPE(N + F);        /* of `sorted` */
    const Int *apart SHAPE(n); /* 1 for modes that are polynomials in a flight: resonant, critically damped; kind 1 */
    const double *V OR_NULL(n, n);        /* of `up` and `low` */
} Free;

/* State of a motion, advanced in place. Zero but for t, eta, rate at the start. */
typedef struct {
    Int piece, begun, waits, hit;  /* piece of the records; 1 after the start; 1 before an impact, of contact `hit`; 2: one driven back */
    Int still;                     /* events without an advance of time */
    Int since;                     /* flights and steps of series since the last mark */
    Int evaluations;               /* series, and looks at the gaps of flights, so far */
    double t, late;                /* time, and its rounding */
    double leap;                   /* length of the last leap */
    double fastest;                /* impact so far */
    double together;               /* roundings of the time within which rigid stops are hit together */
    double *eta SHAPE(n), *rate SHAPE(n);
    double *lost SHAPE(2, n);      /* roundings of eta, rate */
    double *speed SHAPE(m);        /* at which a gap opens after an impact */
    double *size SHAPE(m);         /* largest rounding of a contact's position since its last event */
    double *slack SHAPE(m);        /* rounding of contacts of springs that move by rounding alone; else 0 */
    Int *side SHAPE(m);
    Int *fresh SHAPE(m), *fresh_side SHAPE(m); /* number of derivatives of the gap to fresh_side that start at zero exactly */
    Int *closed SHAPE(m);          /* the rigid stop that a contact is on */
} State;

/* Results of exact_follow. Marks are states from which a part of the motion is computed again. */
typedef struct {
    Int room, marks, events, blows; /* of the arrays; numbers used */
    Int n_stations, station;        /* numbers of stations, and of those passed */
    double *mark_t SHAPE(room), *mark_eta SHAPE(room, n), *mark_rate SHAPE(room, n);
    Int *mark_side SHAPE(room, m);
    double *event_t SHAPE(room);
    Int *event_contact SHAPE(room), *event_side SHAPE(room), *event_mark SHAPE(room); /* contact, its new side (REBOUND times the stop), mark behind it */
    double *blow_t SHAPE(room), *blow_impulse SHAPE(room); /* impulses of rigid stops on the positions; */
    double *blow_before SHAPE(room), *blow_after SHAPE(room); /* their rates */
    Int *blow_contact SHAPE(room), *blow_side SHAPE(room), *blow_mark SHAPE(room); /* contact, its stop, mark behind it */
    const double *stations SHAPE(n_stations); /* increasing times */
    double *eta_at SHAPE(n_stations, n), *rate_at SHAPE(n_stations, n);
    double *force_at SHAPE(n_stations, m); /* held forces */
} Output;

API Int exact_follow(const Free *f, State *state, double t_end, Output *out);

/* States from which parts of a motion are computed again. */
typedef struct {
    Int count;
    const double *t SHAPE(count), *eta SHAPE(count, n), *rate SHAPE(count, n);
    const Int *side SHAPE(count, m);
} Marks;

/* The motion again at `count` times, each from the mark of this number: `mark` (count,) is not decreasing, and the times
 * (count,) of one mark increase. state: memory for it. */
API Int exact_read(const Free *f, State *state, const Marks *marks, Int count, const double *times, const Int *mark,
                   double *eta_at, double *rate_at, double *force_at);

/* Largest force and impulse of a compliant contact, or impulse of the reaction of a rigid one, in spans from starts
 * to ends (count,), which lie in order. */
API Int exact_press(const Free *f, State *state, const Marks *marks, Int contact, Int count, const double *starts,
                    const double *ends, double *peak, double *impulse);

#endif
