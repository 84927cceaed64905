/* The energy balance of a march, step by step. */
#include "loops.h"
#include "march.h"

/* A contact at the last step: its force, the part of it that is not elastic, the power of that part, its position. */
typedef struct {
    double force, beyond, power, last;
} Touch;

/* Memory: states before and after a step, coefficients, what the loads pull. */
typedef struct {
    double *z, *new, *c, *pulled;
    Touch *touch;
} Scratch;

/* The state z at the start, held twice, of the components that are carried; the others are zero. */
static void begin(const Account *s, double *z)
{
    Int half = s->a * s->n;
    memset(z, 0, (size_t)(2 * half) * sizeof *z);
    for (Int c = 0; c < s->carried; c++) {
        memcpy(z + s->place[c] * s->n, s->start + c * s->n, (size_t)s->n * sizeof *z);
        memcpy(z + half + s->place[c] * s->n, s->start + c * s->n, (size_t)s->n * sizeof *z);
    }
}

/* The state after step k, from x->z in x->new, both held twice. */
static void take_step(const Account *s, Int k, Scratch *x)
{
    Int D = s->a * s->n;
    memcpy(x->c, s->g + k * s->d, (size_t)s->d * sizeof *x->c);
    x->c[0] = 1.0;
    turn(s->transition, s->a, s->n, D, x->z, x->new);
    add_rows(x->new, D, x->c, s->driven, D, s->d);
    for (Int i = 0; i < s->F; i++)
        if (s->forces[k * s->F + i] != 0.0) add_rows(x->new, D, s->forces + k * s->F + i, s->push + i * D, D, 1);
    memcpy(x->new + D, x->new, (size_t)D * sizeof *x->new);
}

static void swap(Scratch *x)
{
    double *z = x->z;
    x->z = x->new, x->new = z;
}

/* Kinetic and elastic energy of q and q'. */
HOT static void energies_of(const double *restrict squares, const double *restrict q, const double *restrict v, Int n,
                            double *restrict out)
{
    double s = 0.0, t = 0.0;
#pragma omp simd reduction(+ : s, t)
    for (Int j = 0; j < n; j++) s += v[j] * v[j], t += squares[j] * q[j] * q[j];
    out[0] = 0.5 * s, out[1] = 0.5 * t;
}

/* Damping times the squares of the way of q in a step, and of the sum of q' before and after. */
HOT static void dashpots(const double *restrict damping, const double *restrict q0, const double *restrict q1,
                         const double *restrict v0, const double *restrict v1, Int n, double *restrict out)
{
    double s = 0.0, t = 0.0;
#pragma omp simd reduction(+ : s, t)
    for (Int j = 0; j < n; j++) {
        s += damping[j] * (q1[j] - q0[j]) * (q1[j] - q0[j]);
        t += damping[j] * (v1[j] + v0[j]) * (v1[j] + v0[j]);
    }
    out[0] = s, out[1] = t;
}

typedef struct {
    double energy[3], input, viscous, dissipated;
    Int within;
} Range; /* of steps of one kind, since it began */

static double lost_in(const double *balance, const Range *r)
{
    double before = balance[KINETIC] + balance[ELASTIC] + balance[STOPS];
    return before - (r->energy[0] + r->energy[1] + r->energy[2]) + r->input - r->viscous - r->dissipated;
}

/* The balance with a range that may go on. */
static void settle(const double *balance, const Range *r, double *out, Int apart)
{
    double lost = lost_in(balance, r);
    for (Int e = 0; e < 3; e++) out[e * apart] = r->energy[e];
    out[INPUT * apart] = balance[INPUT] + r->input, out[VISCOUS * apart] = balance[VISCOUS] + r->viscous;
    out[LOSS * apart] = balance[LOSS] + lost, out[DISSIPATED * apart] = balance[DISSIPATED] + r->dissipated;
    for (Int kind = IN_CONTACT; kind <= FREE; kind++)
        out[kind * apart] = balance[kind] + (kind == r->within ? lost : 0.0);
    out[SPREAD * apart] = balance[SPREAD];
}

/* The stop of contact c at step k: its energy; pressed where it presses. */
static double at_stop(const Account *s, Int c, Int k, double u, double rate, Touch *now, Int *pressed)
{
    const Law *l = s->law + c;
    double found = s->node_forces[k * s->m + c], d = depth(u, l);
    double force = force_of_node(u, rate, found, l), elastic_part = -elastic(d, l);
    *now = (Touch){force, damps(l) ? force - elastic_part : 0.0, 0.0, u};
    now->power = now->beyond * rate;
    *pressed += side_of_node(u, rate, found, l) != 0.0;
    return stored(d, l);
}

/* What the contacts do in the step to k: energies in r, what their dashpots dissipate, the work of moving
 * stops in `input`. */
static Int contacts_at(const Account *s, Int k, int rated, Scratch *x, Range *r)
{
    Int m = s->m, pressed = 0;
    r->energy[STOPS] = 0.0;
    for (Int c = 0; c < m; c++) {
        double u = dot(s->rows + c * s->n, x->new, s->n), rate = 0.0;
        Touch *was = x->touch + c, now;
        if (s->moving) u += s->offsets[k * s->moving + c];
        if (rated)
            rate = dot(s->rows + c * s->n, x->new + s->n, s->n) + (s->moving ? s->offset_rates[k * s->moving + c] : 0.0);
        r->energy[STOPS] += at_stop(s, c, k, u, rate, &now, &pressed);
        /* Two rules: force times way, and force times velocity, which has no meaning where the force begins or ends. */
        double by_way = 0.5 * (was->beyond + now.beyond) * (u - was->last), spread = by_way;
        if ((was->beyond == 0.0) == (now.beyond == 0.0)) spread -= 0.5 * s->dt * (was->power + now.power);
        r->dissipated -= by_way;
        s->balance[SPREAD] += fabs(spread);
        if (s->moving)
            r->input -=
                0.5 * (was->force + now.force) * (s->offsets[k * s->moving + c] - s->offsets[(k - 1) * s->moving + c]);
        *was = now;
    }
    return pressed;
}

static Int places(const Account *s, Scratch *x, double *at)
{
    Int used = 0, D = s->a * s->n, m = s->m;
    double **where[] = {&x->z, &x->new, &x->c, &x->pulled};
    Int sizes[] = {2 * D + s->n, 2 * D, s->d, s->L};
    for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++)
        *where[i] = at ? at + used : NULL, used += (sizes[i] + 7) / 8 * 8;
    x->touch = at ? (Touch *)(at + used) : NULL;
    return used + 4 * m;
}

static double *memory_for(const Account *s, Scratch *x)
{
    double *memory = calloc((size_t)places(s, x, NULL) + 8, sizeof *memory);
    if (memory) places(s, x, (double *)(((uintptr_t)memory + 63) / 64 * 64));
    return memory;
}

/* The states (steps, a P) at the ends of the steps from `start`. */
API Int states(const Account *s, double *out)
{
    Scratch x = {0};
    double *memory = memory_for(s, &x);
    if (!memory) return NO_MEMORY;
    begin(s, x.z);
    for (Int k = 0; k < s->steps; k++, swap(&x)) {
        take_step(s, k, &x);
        memcpy(out + k * s->a * s->n, x.new, (size_t)(s->a * s->n) * sizeof *out);
    }
    free(memory);
    return DONE;
}

/* The ledger over a range of steps. The loss is computed over a range of consecutive steps in contact, or without:
 * between its ends no energy is needed, and outputs do not end it. */
API Int account(const Account *s)
{
    Scratch x = {0};
    double *memory = memory_for(s, &x);
    Int n = s->n, m = s->m, touching = 0, row = s->first / s->every, until = s->every - s->first % s->every;
    int rated = 0;
    Range r = {.within = IN_CONTACT};
    if (!memory) return NO_MEMORY;
    for (Int c = 0; c < m; c++) rated |= damps(s->law + c);
    for (Int c = 0; c < m; c++)
        r.energy[STOPS] += at_stop(s, c, 0, s->contacts[c], s->contacts[m + c], x.touch + c, &touching);
    for (Int e = 0; e < s->L; e++) x.pulled[e] = dot(s->loads + e * n, s->y, n);
    energies_of(s->squares, s->y, s->y + n, n, r.energy);
    begin(s, x.z);
    for (Int k = 1; k <= s->steps; k++, swap(&x)) {
        double way[2] = {0.0, 0.0};
        Range step = {.within = r.within};
        Int touched = touching;
        take_step(s, k - 1, &x);
        if (s->damped) dashpots(s->damping, s->y, x.new, s->y + n, x.new + s->n, n, way);
        touching = contacts_at(s, k, rated, &x, &step);
        Int kind = touched + touching ? IN_CONTACT : FREE;
        if (kind != r.within) { /* the loss is settled where contact begins or ends */
            settle(s->balance, &r, s->balance, 1);
            r.within = kind, r.input = r.viscous = r.dissipated = 0.0;
        }
        r.input += step.input, r.dissipated += step.dissipated;
        for (Int e = 0; e < s->L; e++) {
            double now = dot(s->loads + e * n, x.new, n);
            r.input += 0.5 * (s->load_values[(k - 1) * s->L + e] + s->load_values[k * s->L + e]) * (now - x.pulled[e]);
            x.pulled[e] = now;
        }
        r.viscous += way[0] / s->dt;
        s->balance[SPREAD] += fabs(way[0] / s->dt - 0.25 * s->dt * way[1]);
        energies_of(s->squares, x.new, x.new + n, n, r.energy);
        r.energy[STOPS] = step.energy[STOPS];
        if (s->damped || k == s->steps) memcpy(s->y, x.new, (size_t)(2 * n) * sizeof *s->y);
        if (--until == 0) until = s->every, settle(s->balance, &r, s->kept + ++row, s->outputs);
    }
    settle(s->balance, &r, s->balance, 1);
    for (Int c = 0; c < m; c++) {
        s->contacts[c] = x.touch[c].last, s->contacts[m + c] = dot(s->rows + c * n, s->y + n, n);
        if (s->moving) s->contacts[m + c] += s->offset_rates[s->steps * s->moving + c];
    }
    free(memory);
    return DONE;
}
