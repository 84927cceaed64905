/* The energy balance of a march, step by step, or for all steps of a block without contact force at once. */
#include "loops.h"
#include "march.h"

/* A contact at the last step: its force, the part of it that is not elastic, the power of that part, its position. */
typedef struct {
    double force, beyond, power, last;
} Touch;

/* Memory: states before and after a step, coefficients, sums over the modes of a block, paths of a mode. */
typedef struct {
    double *z, *new, *c, *sums, *q, *v, *x, *pulled;
    Touch *touch;
} Scratch;

/* The state z, held twice, of the components that are carried; the others are zero. */
static void begin(const Account *s, const double *start, double *z)
{
    Int half = s->a * s->n;
    memset(z, 0, (size_t)(2 * half) * sizeof *z);
    for (Int c = 0; c < s->carried; c++) {
        memcpy(z + s->place[c] * s->n, start + c * s->n, (size_t)s->n * sizeof *z);
        memcpy(z + half + s->place[c] * s->n, start + c * s->n, (size_t)s->n * sizeof *z);
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

/* Rows of `sums` (.., K) of a block without forces that begins at step `at`. */
enum { OF_V, OF_Q, OF_WAY, OF_RATE, OF_CONTACTS };

HOT static void add_mode(const double *restrict q, const double *restrict v, double square, double damping, double q0,
                         double v0, Int K, double *restrict sums)
{
    double *restrict of_v = sums + OF_V * K, *restrict of_q = sums + OF_Q * K, *restrict way = sums + OF_WAY * K,
                     *restrict rate = sums + OF_RATE * K;
    for (Int i = 0; i < K; i++) of_v[i] += v[i] * v[i], of_q[i] += square * q[i] * q[i];
    if (damping == 0.0) return;
    way[0] += damping * (q[0] - q0) * (q[0] - q0), rate[0] += damping * (v[0] + v0) * (v[0] + v0);
    for (Int i = 1; i < K; i++) {
        way[i] += damping * (q[i] - q[i - 1]) * (q[i] - q[i - 1]);
        rate[i] += damping * (v[i] + v[i - 1]) * (v[i] + v[i - 1]);
    }
}

HOT static void add_scaled(double *restrict out, double x, const double *restrict row, Int n)
{
    for (Int i = 0; i < n; i++) out[i] += x * row[i];
}

/* Sums over the modes at the ends of all steps of block b, without forces, which begins at step `at`. */
static void pass_free(const Account *s, Int b, Int at, Int count, int rated, Scratch *x)
{
    Int n = s->n, m = s->m, K = s->K, T = s->terms;
    memset(x->sums, 0, (size_t)((OF_CONTACTS + 2 * m + s->L) * K) * sizeof(double));
    for (Int e = 0; e < s->acting; e++) x->x[s->carried + e] = s->g[at * s->d + s->which[e]];
    for (Int j = 0; j < n; j++) {
        for (Int t = 0; t < s->carried; t++) x->x[t] = s->starts[b * s->stride + t * n + j];
        memset(x->q, 0, (size_t)K * sizeof(double));
        memset(x->v, 0, (size_t)K * sizeof(double));
        add_rows(x->q, K, x->x, s->paths + 2 * j * T * K, K, T);
        add_rows(x->v, K, x->x, s->paths + (2 * j + 1) * T * K, K, T);
        add_mode(x->q, x->v, s->squares[j], s->damped ? s->damping[j] : 0.0, s->y[j], s->y[n + j], K, x->sums);
        for (Int c = 0; c < m; c++) {
            add_scaled(x->sums + (OF_CONTACTS + c) * K, s->rows[c * n + j], x->q, K);
            if (rated) add_scaled(x->sums + (OF_CONTACTS + m + c) * K, s->rows[c * n + j], x->v, K);
        }
        for (Int e = 0; e < s->L; e++)
            add_scaled(x->sums + (OF_CONTACTS + 2 * m + e) * K, s->loads[e * n + j], x->q, K);
        s->y[j] = x->q[count - 1], s->y[n + j] = x->v[count - 1];
    }
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
static Int contacts_at(const Account *s, Int k, Int i, int quiet, int rated, Scratch *x, Range *r)
{
    Int m = s->m, K = s->K, pressed = 0;
    r->energy[STOPS] = 0.0;
    for (Int c = 0; c < m; c++) {
        double u = quiet ? x->sums[(OF_CONTACTS + c) * K + i] : dot(s->rows + c * s->n, x->new, s->n), rate = 0.0;
        Touch *was = x->touch + c, now;
        if (s->moving) u += s->offsets[k * s->moving + c];
        if (rated)
            rate = (quiet ? x->sums[(OF_CONTACTS + m + c) * K + i] : dot(s->rows + c * s->n, x->new + s->n, s->n)) +
                   (s->moving ? s->offset_rates[k * s->moving + c] : 0.0);
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
    double **where[] = {&x->z, &x->new, &x->c, &x->sums, &x->q, &x->v, &x->x, &x->pulled};
    Int sizes[] = {2 * D + s->n, 2 * D, s->d, (OF_CONTACTS + 2 * m + s->L) * s->K, s->K, s->K, s->terms, s->L};
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

/* The states (steps, a P) at the ends of the steps from `starts`. */
API Int states(const Account *s, double *out)
{
    Scratch x = {0};
    double *memory = memory_for(s, &x);
    if (!memory) return NO_MEMORY;
    begin(s, s->starts, x.z);
    for (Int k = 0; k < s->steps; k++, swap(&x)) {
        take_step(s, k, &x);
        memcpy(out + k * s->a * s->n, x.new, (size_t)(s->a * s->n) * sizeof *out);
    }
    free(memory);
    return DONE;
}

/* The ledger over a stretch of steps. The loss is computed over a range of consecutive steps in contact, or without:
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
    for (Int b = 0; b < s->blocks; b++) {
        Int begun = b * s->block, count = s->block < s->steps - begun ? s->block : s->steps - begun;
        int quiet = s->K > 0; /* without forces the motion over the whole block is a fixed linear map */
        for (Int i = begun * s->F; quiet && i < (begun + count) * s->F; i++) quiet = s->forces[i] == 0.0;
        if (quiet)
            pass_free(s, b, begun, count, rated, &x);
        else
            begin(s, s->starts + b * s->stride, x.z);
        for (Int i = 0; i < count; i++) {
            Int k = begun + i + 1, touched = touching;
            double energies[2], way[2] = {0.0, 0.0};
            if (quiet) {
                energies[0] = 0.5 * x.sums[OF_V * s->K + i], energies[1] = 0.5 * x.sums[OF_Q * s->K + i];
                way[0] = x.sums[OF_WAY * s->K + i], way[1] = x.sums[OF_RATE * s->K + i];
            } else {
                take_step(s, k - 1, &x);
                energies_of(s->squares, x.new, x.new + s->n, n, energies);
                if (s->damped) dashpots(s->damping, s->y, x.new, s->y + n, x.new + s->n, n, way);
            }
            Range step = {.within = r.within};
            touching = contacts_at(s, k, i, quiet, rated, &x, &step);
            Int kind = touched + touching ? IN_CONTACT : FREE;
            if (kind != r.within) { /* the loss is settled where contact begins or ends */
                settle(s->balance, &r, s->balance, 1);
                r.within = kind, r.input = r.viscous = r.dissipated = 0.0;
            }
            r.input += step.input, r.dissipated += step.dissipated;
            for (Int e = 0; e < s->L; e++) {
                double now = quiet ? x.sums[(OF_CONTACTS + 2 * m + e) * s->K + i] : dot(s->loads + e * n, x.new, n);
                r.input +=
                    0.5 * (s->load_values[(k - 1) * s->L + e] + s->load_values[k * s->L + e]) * (now - x.pulled[e]);
                x.pulled[e] = now;
            }
            r.viscous += way[0] / s->dt;
            s->balance[SPREAD] += fabs(way[0] / s->dt - 0.25 * s->dt * way[1]);
            r.energy[KINETIC] = energies[0], r.energy[ELASTIC] = energies[1], r.energy[STOPS] = step.energy[STOPS];
            if (!quiet) {
                if (s->damped || i == count - 1) {
                    memcpy(s->y, x.new, (size_t)n * sizeof *s->y);
                    memcpy(s->y + n, x.new + s->n, (size_t)n * sizeof *s->y);
                }
                swap(&x);
            }
            if (--until == 0) until = s->every, settle(s->balance, &r, s->kept + ++row, s->outputs);
        }
    }
    settle(s->balance, &r, s->balance, 1);
    for (Int c = 0; c < m; c++) {
        s->contacts[c] = x.touch[c].last, s->contacts[m + c] = dot(s->rows + c * n, s->y + n, n);
        if (s->moving) s->contacts[m + c] += s->offset_rates[s->steps * s->moving + c];
    }
    free(memory);
    return DONE;
}
