/* The march in blocks of K steps of a scheme.
 *
 * A block is one linear map of x = (state, drive at its start, forces of its nodes), the forces from a multiple of 8
 * on. Its linear part costs two products; the forces of the stops are then found node by node, each of which
 * moves what comes after it. `effects` on x give velocities at the ends of steps, where they are asked for.
 */
#include "march.h"
#include "loops.h"
#include "node.h"
#include "polynomial.h"

#define OVERFLOWN 1e100 /* a position beyond ends the run; its square, in an energy, is still a number */
#define ON        1e-14 /* of a position: so near a stop a node is on it */
#define DENSE     8     /* velocities at outputs further apart than so many steps are computed one by one */
#define ON_STOP   1e-13 /* of the terms of a predicted position: so near a stop it is on it */

/* A run on its way, and memory. */
typedef struct {
    const Block *b;
    const Drive *drive;
    const Run *run;
    Node node;
    Int wide, base;                /* R + D; where the forces begin in x */
    double *out, *x;               /* of a block: entries and new state; x of this block and of the one before (2, W) */
    double *u, *v, *node_force;    /* (K,) positions, velocities and nodes' forces of a channel */
    double *low, *high, *stiff;    /* stops of a panel's entries; of one contact the stiffness of every node (N,) */
    Int rows, resumed;             /* free row of events, first block of this call */
    Int touched[2];                /* 1 where a stop is touched in a block */
} Motion;

/* ------------------------------------------------------------------ a block */

/* Entry j with the forces first..i-1 of its panel, which have not yet pushed it. */
static inline double pushed(const Motion *s, const double *f, Int first, Int i, Int j)
{
    double u = s->out[j];
    for (Int e = first; e < i; e++) u += f[e] * s->b->push[e * s->wide + j];
    return u;
}

/* The forces at the node whose contacts begin with i, in x->F; 0 where none acts, -1 where they were not found. */
static int node_forces(Motion *s, const double *f, Int first, Int i)
{
    const Block *b = s->b;
    const Law *law = s->run->law;
    Node *x = &s->node;
    Int m = s->run->m, wide = s->wide, beyond = 0;
    const double *S = b->push + i * wide;
    for (Int c = 0; c < m; c++) {
        x->r[c] = pushed(s, f, first, i, i + c);
        beyond |= side_of(x->r[c], law + c) != 0.0;
        if (b->rule == MEAN) beyond |= side_of(x->before[c], law + c) != 0.0; /* from one end of the step */
    }
    if (!beyond) return 0;
    for (Int c = 0; b->rated && c < m; c++) x->w[c] = pushed(s, f, first, i, b->rates[i + c]);
    if (m == 1) {
        double s_rate = b->rated ? S[b->rates[i]] : 0.0;
        x->F[0] = force_alone(x->r[0], x->w[0], S[i], s_rate, x->before[0], b->rule, law).F;
        return isnan(x->F[0]) && !isnan(x->r[0]) ? -1 : 1;
    }
    if (b->rule == LINEAR) {
        solve_springs(x->r, S + i, wide, law, m, x);
        return 1;
    }
    for (Int c = 0; c < m; c++)
        for (Int e = 0; e < m; e++) {
            x->S[c * m + e] = S[e * wide + i + c];
            x->S_rate[c * m + e] = b->rated ? S[e * wide + b->rates[i + c]] : 0.0;
        }
    solve_laws(x, b->rule, law, m);
    for (Int c = 0; c < m; c++)
        if (isnan(x->F[c]) && !isnan(x->r[c])) return -1;
    return 1;
}

/* A panel of one contact that is a spring; the loops are for the compiler to unroll. */
static inline void press_springs(const double *restrict push, Int wide, double g1, double g2,
                                 const double *restrict stiff, const double *restrict out, double *restrict f)
{
    double force[8];
#pragma GCC unroll 8
    for (int i = 0; i < 8; i++) {
        double r = out[i];
#pragma GCC unroll 8
        for (int e = 0; e < i; e++) r += force[e] * push[e * wide + i];
        force[i] = stiff[i] * (least(most(r, g1), g2) - r);
    }
    for (int i = 0; i < 8; i++) f[i] = force[i];
}

/* The forces f of the first `nodes` nodes, panel by panel: nodes of a panel look up what those before them push, all
 * that comes after is pushed in one pass. `good` becomes the first node whose force is not finite: those from it on have
 * none. 0 where no stop is touched, 1 where one is, -1 - i where the forces of node i were not found. */
static Int resolve(Motion *s, double *f, Int nodes, Int *good)
{
    const Block *b = s->b;
    const Law *law = s->run->law;
    Node *x = &s->node;
    double *out = s->out;
    Int m = s->run->m, wide = s->wide, panel = m < 8 ? 8 / m * m : m, touched = 0,
        springs = m == 1 && b->rule == LINEAR;
    memset(f, 0, (size_t)b->N * sizeof *f);
    for (Int first = 0; first < nodes; first += panel) {
        Int end = first + panel < nodes ? first + panel : nodes,
            any = beyond(out + first, s->low, s->high, end - first) > 0;
        for (Int c = 0; b->rule == MEAN && c < m; c++) any |= side_of(x->before[c], law + c) != 0.0;
        if (any) {
            const double *push = b->push + first * wide + first;
            if (springs) {
                press_springs(push, wide, law->g1, law->g2, s->stiff + first, out + first, f + first);
                touched = 1;
            }
            for (Int i = first; !springs && i < end; i += m) {
                int acts = node_forces(s, f, first, i);
                if (acts < 0) return -1 - i;
                for (Int c = 0; acts && c < m; c++) f[i + c] = x->F[c], touched = 1;
                for (Int c = 0; b->rule == MEAN && c < m; c++) x->before[c] = pushed(s, f, first, i + m, i + c);
            }
            Int i = first;
            while (i < end && isfinite(f[i])) i++;
            if (i < end) *good = nodes = end = i;
            for (; i < first + panel; i++) f[i] = 0.0; /* of a spring also of steps that are not asked for */
            add_rows(out + first, wide - first, f + first, push, wide, end - first);
        } else if (b->rule == MEAN)
            for (Int c = 0; c < m; c++) x->before[c] = out[end - m + c];
    }
    return touched;
}

/* The drive g at t. */
static void drive_at(const Drive *d, double t, double *g)
{
    g[0] = d->constant;
    for (Int f = 0; f < d->F; f++) g[1 + 2 * f] = sin(d->frequencies[f] * t), g[2 + 2 * f] = cos(d->frequencies[f] * t);
}

static double *x_of(const Motion *s, Int block) { return s->x + block % 2 * s->run->W; }

/* The velocity of channel c at the end of step k of a block. No force acts before its own step. */
static double speed(const Motion *s, Int block, Int k, Int c)
{
    const Run *run = s->run;
    Int K = s->b->K, row = c * K + k, length = s->base + (s->touched[block % 2] ? (k + 1) * s->b->nodes / K : 0);
    double v = dot(run->effects + row * run->W, x_of(s, block), length);
    return run->inflow ? v + run->inflow_velocity[block * s->b->C * K + row] : v;
}

/* Its velocities at the ends of all steps of a block, in s->v. */
static const double *speeds(const Motion *s, Int block, Int c)
{
    const Run *run = s->run;
    Int K = s->b->K, row = c * K, k = 0;
    for (; k + 8 <= K; k += 8) {
        Int length = s->base + (s->touched[block % 2] ? (k + 8) * s->b->nodes / K : 0);
        dots(run->effects + (row + k) * run->W, run->W, x_of(s, block), length, s->v + k);
    }
    for (Int j = 0; run->inflow && j < k; j++) s->v[j] += run->inflow_velocity[block * s->b->C * K + row + j];
    for (; k < K; k++) s->v[k] = speed(s, block, k, c);
    return s->v;
}

/* ------------------------------------------------------------------ outputs */

/* Steps of a block, which begins after step `at`, before its first output. */
static Int first_output(const Run *r, Int at) { return r->every - 1 - at % r->every; }

/* The outputs of channel c in a block of `count` steps after step `at`. */
static void keep(const Motion *s, Int block, Int c, Int at, Int count)
{
    const Block *b = s->b;
    const Run *run = s->run;
    Int C = b->C, m = run->m, first = b->end_first[c], apart = b->end_stride[c], o = at / run->every + 1;
    const double *v = run->every < DENSE ? speeds(s, block, c) : NULL;
    for (Int k = first_output(run, at); k < count; k += run->every, o++) {
        double u = s->out[first + k * apart];
        run->positions[o * C + c] = u;
        run->velocities[o * C + c] = v ? v[k] : speed(s, block, k, c);
        if (run->times && c == 0) run->times[o] = (double)(o * run->every) * run->dt;
        if (run->node_forces && c < m && first < b->N) run->node_forces[o * m + c] = x_of(s, block)[s->base + first + k * apart];
        if (run->contact_forces && c < m) run->contact_forces[o * m + c] = -run->law[c].kappa * depth(u, run->law + c);
    }
}

/* ------------------------------------------------------------------ impacts */

/* Least s in (0, 1] at which the cubic Hermite interpolant of a gap, gap0 > 0 >= gap1, is zero. */
static double first_crossing(double gap0, double rate0, double gap1, double rate1)
{
    double slope = gap1 - gap0, p[4] = {gap0, rate0, 3.0 * slope - 2.0 * rate0 - rate1, rate0 + rate1 - 2.0 * slope};
    double s = first_zero(p, 4, 1.0, 0);
    return s < 0.0 ? 1.0 : s;
}

/* Fraction of the step at which contact with the stop on `side` begins or ends. At a damped stop that is reached, to
 * rounding, the sign of the force dates it, not the crossing. */
API double switch_time(double u0, double v0, double u1, double v1, double side, const Law *l, double dt)
{
    double stop = side > 0.0 ? l->g2 : l->g1, sign = u1 > u0 ? 1.0 : -1.0;
    if (damps(l) && side * (u0 - stop) > -ON * most(fabs(u0), fabs(stop))) {
        double before = pressure(side * (u0 - stop), side * v0, l), after = pressure(side * (u1 - stop), side * v1, l);
        if (before * after < 0.0) return before / (before - after);
        if (side * (u1 - stop) > 0.0) return 0.0;
    }
    return first_crossing(sign * (stop - u0), -sign * v0 * dt, sign * (stop - u1), -sign * v1 * dt);
}

/* Add the steps u (count,) to a tally; new impacts are appended from row `rows` on. Their TIME, and the END of those
 * that end, are the step before the crossing; END is -1 of an open one. v, node_force: velocities and the nodes'
 * forces, or NULL. means: the forces are means over the steps; impulses are theirs, the last that of the step in which
 * a contact ends. */
static inline Int scan(const double *u, const double *v, const double *node_force, int means, Int count, const Law *l,
                       double dt, double *tally, double *events, Int rows, Int first)
{
    double side = tally[SIDE], *open = tally[ROW] >= 0.0 ? events + (Int)tally[ROW] * EVENT : NULL, none[EVENT] = {0.0};
    double touching = 0.0, total = 0.0, highest = 0.0, impulse = 0.0,
           peak = 0.0; /* of all, and of the visit to a stop */
    Int passed = (Int)tally[SINCE] - first, k = 0;
    while (k < count) { /* from one change of side to the next */
        double *visit = open ? open : none;
        for (impulse = peak = 0.0; k < count; k++) {
            double rate = v ? v[k] : 0.0, force = node_force && !means ? node_force[k] : NAN;
            if (side_of_node(u[k], rate, force, l) != side) break;
            if (k < passed || (side == 0.0 && !means)) continue;
            double size = side != 0.0 ? fabs(force_of_node(u[k], rate, force, l)) : 0.0;
            impulse += means ? fabs(node_force[k]) : size, peak = most(peak, size), touching += side != 0.0;
        }
        total += impulse, highest = most(highest, peak);
        visit[IMPACT_IMPULSE] += impulse * dt, visit[IMPACT_PEAK] = most(visit[IMPACT_PEAK], peak);
        if (k == count) break;
        side = side_of_node(u[k], v ? v[k] : 0.0, node_force && !means ? node_force[k] : NAN, l);
        if (open) open[END] = (double)k;
        /* Of means: the step that leaves the stop has contact in part of it. */
        if (open && side == 0.0 && means && k >= passed) open[IMPACT_IMPULSE] += fabs(node_force[k]) * dt;
        open = NULL;
        if (side != 0.0 && k >= passed) {
            open = events + rows++ * EVENT;
            open[TIME] = (double)k, open[STOP] = side, open[END] = -1.0, open[IMPACT_PEAK] = open[IMPACT_IMPULSE] = 0.0;
        }
    }
    tally[TOUCHING] += touching, tally[PEAK] = most(tally[PEAK], highest), tally[IMPULSE] += total * dt;
    tally[SIDE] = side, tally[ROW] = open ? (double)((open - events) / EVENT) : -1.0;
    return rows;
}

/* Impacts of contact c in a block. */
static void watch(Motion *s, Int block, Int c, Int at, Int count)
{
    const Block *b = s->b;
    const Run *run = s->run;
    const Law *l = run->law + c;
    const double *v = damps(l) ? speeds(s, block, c) : NULL;
    double *tally = run->tally + c * TALLY, *node_force = NULL;
    Int entry = b->end_first[c], stride = b->end_stride[c], opened = (Int)tally[ROW], means = b->rule == MEAN;
    for (Int k = 0; k < count; k++) s->u[k] = s->out[entry + k * stride];
    if (means || (jumps(l) && entry < b->N)) {
        node_force = s->node_force;
        for (Int k = 0; k < count; k++) node_force[k] = x_of(s, block)[s->base + (means ? k * run->m + c : entry + k * stride)];
    }
    /* Where F = F(u) once more: the compiler leaves out what stands behind an argument that is NULL. */
    Int new = v || node_force
                  ? scan(s->u, v, node_force, (int)means, count, l, run->dt, tally, run->events, s->rows, at)
                  : scan(s->u, NULL, NULL, 0, count, l, run->dt, tally, run->events, s->rows, at);
    if (!means && b->rule != LINEAR) /* the force at the last step counts half, see ``end_tallies`` */
        tally[LAST] =
            fabs(force_of_node(s->u[count - 1], v ? v[count - 1] : 0.0, node_force ? node_force[count - 1] : NAN, l));
    /* The end of the impact that was open before, then times and ends of the new ones. */
    for (Int change = 2 * s->rows - 1; change < 2 * new; change++) {
        Int row = change < 2 * s->rows ? opened : change / 2, column = change % 2 ? END : TIME;
        if (row < 0) continue;
        double *e = run->events + row * EVENT;
        Int k = (Int)e[column];
        if (k < 0) continue;
        double u0 = k > 0 ? s->u[k - 1] : run->position[c];
        double v0 = k > 0                ? speed(s, block, k - 1, c)
                    : block > s->resumed ? speed(s, block - 1, b->K - 1, c)
                                         : run->velocity[c];
        double inside = switch_time(u0, v0, s->u[k], speed(s, block, k, c), e[STOP], l, run->dt);
        e[column] = ((double)(at + k) + inside) * run->dt;
        e[CONTACT] = (double)c;
    }
    s->rows = new;
}

/* ------------------------------------------------------------------ the run */

/* One block: 0 where the run goes on. */
static int pass_block(Motion *s, Int block)
{
    const Block *b = s->b;
    const Drive *drive = s->drive;
    const Run *run = s->run;
    Int K = b->K, m = run->m, R = b->R, D = b->D, wide = s->wide, at = run->first + block * K,
        count = K < run->steps - block * K ? K : run->steps - block * K, d = 1 + 2 * drive->F;
    double *out = s->out, *z = run->z, *x = x_of(s, block), *g = x + D, *f = x + s->base;
    /* Without contact forces: positions at all nodes, and the state at the end. */
    memcpy(x, z, (size_t)D * sizeof *x);
    drive_at(drive, (double)at * run->dt, g);
    if (run->inflow)
        memcpy(out, run->inflow + block * wide, (size_t)R * sizeof *out);
    else
        memset(out, 0, (size_t)R * sizeof *out);
    turn(b->transition, b->a, b->n, D, z, out + R);
    for (Int j = R; run->inflow && j < wide; j++) out[j] += run->inflow[block * wide + j];
    add_rows(out, R, z, b->reading, R, D);
    Int still = g[0] == 0.0;
    add_rows(out, wide, g + still, drive->rows + still * wide, wide, d - still);
    /* Then the forces of the stops, each of which moves what comes after it. */
    for (Int c = 0; b->rule == MEAN && c < m; c++) s->node.before[c] = run->position[c];
    Int per_step = b->nodes / K, good = count * per_step, touched = m ? resolve(s, f, good, &good) : 0;
    if (touched < 0) {
        *run->diverged = -(at + (-1 - touched) * K / b->nodes + 1);
        return 1;
    }
    s->touched[block % 2] = touched != 0;
    if (run->starts) {
        Int state = D + (b->a - 1) * b->n;
        memcpy(run->starts + block * state, z, (size_t)state * sizeof *z);
        if (b->N) memcpy(run->forces + block * b->N, f, (size_t)b->N * sizeof *z);
    }
    Int last = m && good < count * per_step ? good / per_step : count; /* steps before the position that overflows */
    for (Int c = 0; c < b->C; c++) {
        const double *u = out + b->end_first[c];
        Int apart = b->end_stride[c];
        if (!(fabs(u[(count - 1) * apart]) < OVERFLOWN) || last < count)
            for (Int k = last - 1; k >= 0; k--)
                if (!(fabs(u[k * apart]) < OVERFLOWN)) last = k;
    }
    if (last < count) *run->diverged = at + last + 1;
    for (Int c = 0; c < b->C && last > 0; c++) {
        if (run->outputs) keep(s, block, c, at, last);
        /* A position that is not at a node may be beyond a stop although no node is. */
        if (c < m && (touched || run->tally[c * TALLY + SIDE] != 0.0 || b->end_first[c] >= b->N))
            watch(s, block, c, at, last);
        run->position[c] = out[b->end_first[c] + (last - 1) * b->end_stride[c]];
    }
    if (last < count) return 1;
    memcpy(z, out + R, (size_t)D * sizeof *z);
    memcpy(z + D, z, (size_t)((b->a - 1) * b->n) * sizeof *z);
    return 0;
}

/* Places in memory `at`, each at a 64-byte boundary, none in NULL; returns its length in numbers. */
static Int places(Motion *s, double *at)
{
    const Block *b = s->b;
    Int m = s->run->m, used = 0, panel = m < 8 ? 8 : m, K = b->K;
    double **where[] = {&s->out, &s->x, &s->u, &s->v, &s->node_force, &s->low, &s->high, &s->stiff};
    Int sizes[] = {s->wide, 2 * s->run->W, K, K, K, panel, panel, b->N};
    for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        *where[i] = at ? at + used : NULL;
        used += (sizes[i] + 7) / 8 * 8;
    }
    return used + node_memory(&s->node, m, at ? at + used : NULL);
}

API Int march(const Block *b, const Drive *drive, const Run *run)
{
    Motion s = {.b = b, .drive = drive, .run = run, .wide = b->R + b->D, .base = run->W - b->N,
                .rows = run->cursor[1], .resumed = run->cursor[0]};
    Int m = run->m, blocks = (run->steps + b->K - 1) / b->K, panel = m && m < 8 ? 8 / m * m : m, block, full = 0;
    void *memory;
    double *at = aligned(places(&s, NULL), &memory);
    if (!at) return NO_MEMORY;
    places(&s, at);
    for (Int j = 0; j < panel; j++) s.low[j] = run->law[j % m].g1, s.high[j] = run->law[j % m].g2;
    for (Int j = 0; m == 1 && j < b->nodes; j++) s.stiff[j] = spring_stiffness(b->push[j * s.wide + j], run->law);
    for (block = run->cursor[0]; block < blocks && !*run->diverged; block++) {
        if ((full = s.rows + m * b->K > run->room)) break;
        if (pass_block(&s, block) && run->outputs) /* the outputs that follow are not known */
            for (Int j = ((llabs(*run->diverged) - 1) / run->every + 1) * b->C; j < run->outputs * b->C; j++)
                run->positions[j] = run->velocities[j] = NAN;
    }
    Int count = block < blocks ? b->K : run->steps - (blocks - 1) * b->K; /* of the last block */
    for (Int c = 0; c < b->C && block > s.resumed && !*run->diverged; c++)
        run->velocity[c] = speed(&s, block - 1, count - 1, c);
    run->cursor[0] = full ? block : 0, run->cursor[1] = s.rows;
    free(memory);
    return full ? LIST_IS_FULL : DONE;
}

/* ------------------------------------------------------------------ states that a block passes over */

API void states(Int a, Int n, Int F, Int steps, Int K, const double *transition, const double *push,
                const double *forces, const double *starts, double *z, double *out)
{
    Int D = a * n;
    double *new = z + 2 * D;
    for (Int k = 0; k < steps; k++) {
        memcpy(z, k % K ? new : starts + k / K * D, (size_t)D * sizeof *z);
        memcpy(z + D, z, (size_t)D * sizeof *z);
        turn(transition, a, n, D, z, new);
        add_rows(new, D, forces + k * F, push, D, F);
        memcpy(out + (k + 1) * n, new, (size_t)n * sizeof *out);
        memcpy(out + (steps + k + 2) * n, new + n, (size_t)n * sizeof *out);
    }
}

/* ------------------------------------------------------------------ rigid stops: the reactions node by node */

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
