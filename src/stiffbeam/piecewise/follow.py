"""The compiled loop from event to event over the regimes that are already in the table.

In every regime the motion is a sum of pairs and of harmonic responses to the drive g(t),

    q = A x + B y + P g,   q' = D x + E y + P' g,   x' = sigma x + y,   y' = sigma y - omega^2 x + level

Without damping a pair is a mode, x its amplitude and y its rate, sigma = 0, B = D = 0. Where damping couples the modes,
a complex one c exp((sigma + i omega) tau) is the pair x = Re c, y = -omega Im c. A regime that is not known ends the
loop, which goes on when it has been made.

Stops with damping are unilateral Kelvin-Voigt, F = -(kappa d + c d')_+, piecewise linear.
A contact is short of its stop (side 0), pressed (+-1), or beyond a stop that has let go (+-LET_GO). Of d, > 0 into
the stop, and y = d + (c/kappa) d', which has the sign of the force without its cut,

    0 -> 1    where d = 0: the force jumps to c d'          1 -> 2    where y = 0: no adhesion
    2 -> 1    where y = 0 again                             2 -> 0    where d = 0

Only the first event turns tangent vectors: a neighbour enters later by -(row dq)/d', without the force c d' until then,

    dq'+ = dq'- - c M^-1 row^T (row dq)

Source: the saltation matrix of Filippov's theory, as in di Bernardo et al., Piecewise-smooth Dynamical Systems (2008),
section 2.5.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..basics.arrays import Array, IntArray
from ..basics.compiled import compiled, formula, inner, inner_inlined
from ..model.contact import Stops
from ..model.system import System
from .search import search
from .terms import CONSTANT, LEVEL, OMEGA, SIGMA, SQUARE, X, Y, layout, oscillations, pair

LET_GO = 2  # times the side: beyond a damped stop that does not press
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
SECTIONS = 40  # of the golden section: 4e-9 of two samples' distance, where the force is flat
DONE, FULL, UNKNOWN = 0, 1, 2  # why the loop ends; UNKNOWN: no such regime in the table, or one that it cannot follow
# Of ``outward``, which parts of q and q' the pairs make, and of ``inward``, which parts of x and y they make.
PLACE_X, PLACE_Y, SPEED_X, SPEED_Y = range(4)
X_PLACE, X_SPEED, Y_PLACE, Y_SPEED = range(4)


class Table(NamedTuple):
    """R regimes of K pairs at most, n unknowns, m contacts, F drive frequencies, d = 1 + 2 F drive functions.

    sides: (R, m), the stops that press. sizes: (R,), pairs of each; negative for a regime that the loop cannot follow.
    undamped: (R,), not 0 where x makes q alone and y q'. sigma, omega, level: (R, K). order, speeds: (R, K + F), pairs
    and then drives from slow to fast, and (R, 2, K + F), sigma and omega of these. outward: (R, 4, K, n), A, B, D, E
    transposed, inward: (R, 4, n, K). response: (R, 2, d, n), P and P' transposed, of
    the pairs themselves where it is undamped, so that a body at rest stays so to the bit. rows: (R, 2, m, K), what
    contacts see of x and of y; waves: (R, m, d), what they see of g, the offsets included. frequencies: (F,). close:
    (R, p, 2), closes: (R,), pairs of a mode and a drive frequency so close that P would be large and x cancel it; P is
    zero there, and the mode answers that drive from rest at the start of every segment. pulls: (R, p, 2), the force of
    its sine and cosine on the mode.
    g1, g2, lags: (m,), the stops and c/kappa of each contact.
    """

    sides: IntArray
    sizes: IntArray
    undamped: IntArray
    sigma: Array
    omega: Array
    level: Array
    order: IntArray
    speeds: Array
    outward: Array
    inward: Array
    response: Array
    rows: Array
    waves: Array
    frequencies: Array
    close: IntArray
    closes: IntArray
    pulls: Array
    g1: Array
    g2: Array
    lags: Array


@inner_inlined
def regime_at(table: Table, sides: IntArray) -> int:
    """The regime of contacts on these sides (m,), -1 if the loop cannot follow it."""
    for r in range(table.sides.shape[0]):
        # Negative: the loop cannot follow it; 0: a row that is not filled yet.
        same = table.sizes[r] > 0
        for i in range(sides.size):
            pressed = sides[i] if abs(sides[i]) != LET_GO else 0
            same &= table.sides[r, i] == pressed
        if same:
            return r
    return -1


@inner_inlined
def see(table: Table, r: int, x: Array, y: Array, start: float, speeds: Array, terms: Array, seen: Array) -> None:
    """Terms of the gaps in a segment that begins at ``start`` with the pairs x, y, see terms.py."""
    size = table.sizes[r]
    for k in range(speeds.shape[1]):
        j = table.order[r, k]
        sigma, w = table.speeds[r, 0, k], table.speeds[r, 1, k]
        speeds[SIGMA, k], speeds[OMEGA, k], speeds[SQUARE, k] = sigma, w, w * w
        if j < size:
            for i in range(terms.shape[0]):
                a, b = table.rows[r, 0, i, j], table.rows[r, 1, i, j]
                # a x + b y is a pair again, with a y - omega^2 b x as its y; the level is 0 wherever b is not.
                terms[i, X, k], terms[i, Y, k] = a * x[j] + b * y[j], a * y[j] - w * w * b * x[j]
                terms[i, LEVEL, k] = a * table.level[r, j]
            continue
        # A drive is a pair without damping: its value and its rate at ``start``.
        sine = 1 + 2 * (j - size)
        s, c = math.sin(w * start), math.cos(w * start)
        for i in range(terms.shape[0]):
            a, b = table.waves[r, i, sine], table.waves[r, i, sine + 1]
            terms[i, X, k], terms[i, Y, k] = a * s + b * c, w * (a * c - b * s)
    for i in range(terms.shape[0]):
        seen[i, CONSTANT] = table.waves[r, i, 0]


@inner_inlined
def see_close(table: Table, r: int, pairs: Array, at: IntArray) -> None:
    """The close pairs as the contacts ``at`` see them, see ``terms.layout``."""
    for k in range(pairs.shape[0]):
        j = table.close[r, k, 0]
        pairs[k, 0], pairs[k, 1] = table.omega[r, j], table.frequencies[table.close[r, k, 1]]
        pairs[k, 2], pairs[k, 3] = table.pulls[r, k, 0], table.pulls[r, k, 1]
        for i in range(at.size):
            pairs[k, 4 + i] = table.rows[r, 0, at[i], j]


@inner_inlined
def turn(table: Table, r: int, x: Array, y: Array, start: float, tau: float, x1: Array, y1: Array, work: Array) -> None:
    """The pairs and the answers of close pairs at start + tau into x1, y1 (size,), from those at ``start``; work: (3, K
    at least)."""
    size = x.size
    c, s, versine = work[0, :size], work[1, :size], work[2, :size]
    oscillations(table.omega[r, :size], tau, c, s, versine)
    for j in range(size):
        w, sigma, level = table.omega[r, j], table.sigma[r, j], table.level[r, j]
        if sigma != 0.0:
            decay = math.exp(sigma * tau)
            c[j] *= decay
            s[j] *= decay
        x1[j] = x[j] * c[j] + y[j] * s[j] + level * versine[j]
        y1[j] = y[j] * c[j] + (level - w * w * x[j]) * s[j]
    # A close pair answers its drive from rest at ``start``, beside the free motion.
    for k in range(table.closes[r]):
        j = table.close[r, k, 0]
        w, frequency = table.omega[r, j], table.frequencies[table.close[r, k, 1]]
        eta, rate, _ = pair(w, frequency, table.pulls[r, k, 0], table.pulls[r, k, 1], start, tau)
        x1[j] += eta
        y1[j] += rate


@inner_inlined
def drive(table: Table, t: float, g: Array) -> None:
    """g(t) = (1, sin, cos, ...) into (d,)."""
    g[0] = 1.0
    for k in range(table.frequencies.size):
        g[1 + 2 * k], g[2 + 2 * k] = math.sin(table.frequencies[k] * t), math.cos(table.frequencies[k] * t)


@inner_inlined
def leave(table: Table, r: int, x: Array, y: Array, g: Array, q: Array, v: Array) -> None:
    """q and q' (n,) of the pairs x, y, which it may change, and the drive g."""
    A, B = table.outward[r, PLACE_X], table.outward[r, PLACE_Y]
    D, E = table.outward[r, SPEED_X], table.outward[r, SPEED_Y]
    P, rate = table.response[r, 0], table.response[r, 1]
    undamped = table.undamped[r] != 0
    for i in range(q.size):
        q[i], v[i] = 0.0, 0.0
    # Without damping P is the response of the pairs, else that of q and q', see Table.
    for j in range(g.size):
        a, b = (x, y) if undamped else (q, v)
        for i in range(q.size):
            a[i] += P[j, i] * g[j]
        for i in range(q.size):
            b[i] += rate[j, i] * g[j]
    for j in range(x.size):
        for i in range(q.size):
            q[i] += A[j, i] * x[j]
        for i in range(q.size):
            v[i] += E[j, i] * y[j]
    # B and D are zero without damping.
    for j in range(0 if undamped else x.size):
        for i in range(q.size):
            q[i] += B[j, i] * y[j]
        for i in range(q.size):
            v[i] += D[j, i] * x[j]


@inner_inlined
def enter(table: Table, r: int, q: Array, v: Array, g: Array, x: Array, y: Array, work: Array) -> None:
    """The pairs x, y (size,) of q and q' where the drive is g; work: (2, n at least)."""
    A, B = table.inward[r, X_PLACE], table.inward[r, X_SPEED]
    D, E = table.inward[r, Y_PLACE], table.inward[r, Y_SPEED]
    P, rate = table.response[r, 0], table.response[r, 1]
    undamped = table.undamped[r] != 0
    n = q.size
    place, speed = work[0, :n], work[1, :n]
    for i in range(n):
        place[i], speed[i] = q[i], v[i]
    for j in range(x.size):
        x[j], y[j] = 0.0, 0.0
    # The reverse of ``leave``: first the response is taken off, from the pairs where nothing is damped.
    for j in range(g.size):
        a, b = (x, y) if undamped else (place, speed)
        for i in range(n):
            a[i] -= P[j, i] * g[j]
        for i in range(n):
            b[i] -= rate[j, i] * g[j]
    for i in range(n):
        for j in range(x.size):
            x[j] += A[i, j] * place[i]
        for j in range(x.size):
            y[j] += E[i, j] * speed[i]
    for i in range(0 if undamped else n):
        for j in range(x.size):
            x[j] += B[i, j] * speed[i]
        for j in range(x.size):
            y[j] += D[i, j] * place[i]


@inner_inlined
def sizes_of(table: Table, r: int, x: Array, y: Array, q: Array, v: Array, places: Array, speeds: Array) -> None:
    """Sizes of the terms of q and q', the root of the sum of their squares, into places and speeds (n,)."""
    outward = table.outward[r]
    for i in range(q.size):
        a, b = q[i] ** 2, v[i] ** 2
        for j in range(x.size):
            a += (outward[PLACE_X, j, i] * x[j]) ** 2 + (outward[PLACE_Y, j, i] * y[j]) ** 2
            b += (outward[SPEED_X, j, i] * x[j]) ** 2 + (outward[SPEED_Y, j, i] * y[j]) ** 2
        places[i], speeds[i] = math.sqrt(a), math.sqrt(b)


@inner_inlined
def unsettle(
    table: Table, r: int, places: Array, speeds: Array, t: float, noise: Array, size: float, x: Array, y: Array
) -> None:
    """Change the pairs at the start t of a segment by what is lost there: the rounding of t, and of the sums that make
    them of q, q' and the drive; places, speeds: (n,), sizes of the terms of q and q', which it may change.
    noise: (3, K)."""
    late, inward, response = size * noise[0, 0] * t, table.inward[r], table.response[r]
    undamped = table.undamped[r] != 0
    # Damped, the response is a term of q and q'; no function in g exceeds 1, so that its entries are the sizes.
    for i in range(0 if undamped else places.size):
        for j in range(response.shape[1]):
            places[i] += abs(response[0, j, i])
            speeds[i] += abs(response[1, j, i])
    # Errors of independent terms add up as squares.
    for j in range(x.size):
        a = b = 0.0
        for i in range(places.size):
            a += (inward[X_PLACE, i, j] * places[i]) ** 2 + (inward[X_SPEED, i, j] * speeds[i]) ** 2
            b += (inward[Y_PLACE, i, j] * places[i]) ** 2 + (inward[Y_SPEED, i, j] * speeds[i]) ** 2
        for k in range(response.shape[1] if undamped else 0):
            a += response[0, k, j] ** 2
            b += response[1, k, j] ** 2
        # A later start moves the pair by its rate times ``late``; x is changed last, since y needs the old one.
        sigma, w = table.sigma[r, j], table.omega[r, j]
        moved = late * (sigma * x[j] + y[j]) + size * noise[1, j] * math.sqrt(a)
        y[j] += late * (sigma * y[j] - w * w * x[j] + table.level[r, j]) + size * noise[2, j] * math.sqrt(b)
        x[j] += moved


@inner
def watched_of_damped(
    table: Table, r: int, start: float, sides: IntArray, switched: IntArray, speeds: Array, terms: Array, seen: Array,
    pairs: Array,
) -> tuple[IntArray, IntArray, IntArray, Array, Array, IntArray, Array, Array, Array]:  # fmt: skip
    """Gaps to search where stops are damped: of such a stop d or y = d + lag d' is watched, and of one that has let go
    both.

    speeds, terms, seen, pairs: as contacts see them that are not damped. Returns the contact of every gap, 1 where it
    is a force, sides, stops, 1 where it is zero at ``start``, and terms, seen and pairs of the gaps.
    """
    m, K = sides.size, speeds.shape[1]
    # A contact that has let go is watched twice: its second gap stands behind the first ones of all contacts.
    count = m
    for i in range(m):
        count += abs(sides[i]) == LET_GO
    at = np.arange(count)
    chi, resting, force = np.zeros(count, np.int64), np.zeros(count, np.int64), np.zeros(count, np.int64)
    g1, g2 = np.empty(count), np.empty(count)
    _, all_terms, all_seen, all_pairs = layout(count, K, table.closes[r])
    for k in range(pairs.shape[0]):
        for j in range(4):  # slices would be compiled with the message of an error in their shapes, for seconds
            all_pairs[k, j] = pairs[k, j]
    extra = m
    for i in range(m):
        # Gap and rate now: they decide which gap is zero at the start.
        u = rate = 0.0
        for k in range(K):
            u += terms[i, X, k]
            rate += speeds[SIGMA, k] * terms[i, X, k] + terms[i, Y, k]
        u += seen[i, CONSTANT]
        d = u - (table.g2[i] if sides[i] > 0 else table.g1[i])
        gone = abs(sides[i]) == LET_GO
        for again in range(2 if gone else 1):
            w = i if again == 0 else extra
            lag = table.lags[i] if again == 1 or abs(sides[i]) == 1 else 0.0
            at[w], force[w] = i, lag > 0.0
            # d + lag d' of every term is a term again, with the same level.
            for k in range(K):
                a, b, sigma = terms[i, X, k], terms[i, Y, k], speeds[SIGMA, k]
                all_terms[w, X, k] = a + lag * (sigma * a + b)
                all_terms[w, Y, k] = b + lag * (sigma * b - speeds[SQUARE, k] * a + terms[i, LEVEL, k])
                all_terms[w, LEVEL, k] = terms[i, LEVEL, k]
            all_seen[w, CONSTANT] = seen[i, CONSTANT]
            for k in range(pairs.shape[0]):
                all_pairs[k, 4 + w] = pairs[k, 4 + i]
            chi[w] = 0 if again == 1 else (sides[i] // LET_GO if gone else sides[i])
            beyond = again == 1  # only the stop that it is beyond counts
            g1[w] = -math.inf if beyond and sides[i] > 0 else table.g1[i]
            g2[w] = math.inf if beyond and sides[i] < 0 else table.g2[i]
            # Zero after an event: y if the contact has let go, d if it is free. A pressed one came by d = 0 or
            # by y = 0: by the smaller of the two.
            y_now = d + lag * rate
            still = beyond if gone else (lag == 0.0 or abs(y_now) < abs(d))
            resting[w] = switched[i] != 0 and still
        extra += gone
    return at, force, chi, g1, g2, resting, all_terms, all_seen, all_pairs


@compiled
def follow(
    table: Table, t: float, t_end: float, q: Array, v: Array, places: Array, speeds: Array, sides: IntArray,
    switched: IntArray, noise: Array, size: float, out_t: Array, out_regime: IntArray, out_sides: IntArray,
    out_x: Array, out_y: Array, damped: int | None,
) -> tuple[int, int, int, float]:  # fmt: skip
    """Follow the motion from q, q' (n,) at t with the contacts on ``sides`` (m,) until t_end, until the output is full
    or an unknown regime begins.

    switched: (m,), not 0 for contacts that switched at t, so that their gap is exactly zero. places, speeds: (n,), the
    sizes of the terms of q, q'. All of these are those of the last event in the end. noise: (segments, 3, K) in [-1,
    1], what ``unsettle`` takes ``size`` times at the start of every segment; none for size 0. damped: 1 where a stop
    is, else None, and numba leaves out what only damped stops need. Returns (why it ended, segments written,
    evaluations, time of the last event). Raises SolverFailure where the motion overflows or the
    search stands still.
    """
    g, work = np.empty(1 + 2 * table.frequencies.size), np.empty((5, max(q.size, table.sigma.shape[1])))
    count = evaluations = 0
    while count < out_t.size:
        # The regime of the present sides; the caller adds one that is missing.
        r = regime_at(table, sides)
        if r < 0:
            return UNKNOWN, count, evaluations, t
        pairs = table.sizes[r]
        x, y, x1, y1 = out_x[count, :pairs], out_y[count, :pairs], work[3, :pairs], work[4, :pairs]
        # Pairs at the start of the segment, in a copy changed by what rounding loses.
        drive(table, t, g)
        enter(table, r, q, v, g, x, y, work)
        if size > 0.0:
            unsettle(table, r, places, speeds, t, noise[count], size, x, y)
        out_t[count], out_regime[count] = t, r
        for i in range(sides.size):
            out_sides[count, i] = sides[i]
        count += 1
        # Terms of the gaps, and the first event.
        swings, terms, seen, close = layout(sides.size, pairs + table.frequencies.size, table.closes[r])
        see(table, r, x, y, t, swings, terms, seen)
        see_close(table, r, close, np.arange(sides.size))
        at, force, chi, g1, g2, resting = sides, sides, sides, table.g1, table.g2, switched
        if damped is not None:
            at, force, chi, g1, g2, resting, terms, seen, close = watched_of_damped(
                table, r, t, sides, switched, swings, terms, seen, close
            )
        tau, contact, stop, used = search(swings, terms, seen, close, chi, g1, g2, resting, t, t_end)
        evaluations += used
        if contact < 0 or t + tau >= t_end:
            return DONE, count, evaluations, t
        # The side of the contact after the event.
        side = stop
        if damped is not None:
            by_force = force[contact] != 0
            contact = at[contact]
            side = next_side(sides[contact], stop, by_force)
        elif sides[contact] != 0:
            side = 0
        # q and q' at the event, from which the next regime starts.
        turn(table, r, x, y, t, tau, x1, y1, work)
        drive(table, t + tau, g)
        leave(table, r, x1, y1, g, q, v)
        if size > 0.0:
            sizes_of(table, r, x1, y1, q, v, places, speeds)
        # Contacts that switched at this same instant stay marked: one event each an instant, so that time goes on.
        if t + tau > t:
            switched[:] = 0
        sides[contact], switched[contact] = side, 1
        t += tau
    return FULL, count, evaluations, t


# ---------------------------------------------------------------- sides of contacts, before and after an event


def side_of(stops: Stops, u: float, velocity: float) -> int:
    """The side of a contact at u, as in the table above."""
    pressed = int(stops.state(u, velocity))
    return pressed if pressed else LET_GO * int(np.sign(stops.penetration(u))) if stops.dissipative else 0


def pressed(sides: ArrayLike) -> NDArray[np.int64]:
    """chi, 0 where nothing presses."""
    sides = np.asarray(sides, np.int64)
    return np.where(np.abs(sides) == LET_GO, 0, sides)


@formula
def next_side(old: int, met: int, force: bool) -> int:
    """The side after an event of a contact; met: the stop; force: True if y became 0, not d."""
    if old == 0:
        return met
    if not force:
        return 0
    # y = 0: a pressed contact lets go, one that has let go is pressed again.
    return LET_GO * old if abs(old) == 1 else old // LET_GO


def switched_by_force(old: int, new: int) -> bool:
    """Return True if y became 0."""
    return {abs(old), abs(new)} == {1, LET_GO}


def watched(sides: Sequence[int], lags: Array) -> list[tuple[int, float, int, bool]]:
    """Quantity that has to stay positive, (contact, lag, chi, own): d or y = d + lag d', as of a contact on chi.

    own: only the stop it is beyond counts. A contact that has let go is watched twice.
    """
    found = []
    for i, (side, lag) in enumerate(zip(sides, lags.tolist(), strict=True)):
        if abs(side) == LET_GO:
            # Past its stop without pressing: it leaves where d = 0 or presses again where y = 0.
            found += [(i, 0.0, side // LET_GO, False), (i, lag, 0, True)]
        else:
            found.append((i, lag if side else 0.0, side, False))
    return found


def entry(system: System, before: NDArray[np.int64], after: NDArray[np.int64], dq: Array, dv: Array) -> Array:
    """dq' (n, k) after an event from the sides ``before`` to those ``after`` (m,)."""
    # Only an entry makes the force jump: all other events leave tangent vectors as they are.
    for contact, old, new in zip(system.contacts, before.tolist(), after.tolist(), strict=True):
        if contact.stops.damping > 0.0 and old == 0 and new:
            kick = np.linalg.solve(system.mass, contact.row)
            dv = dv - float(contact.stops.damping) * np.outer(kick, contact.row @ dq)
    return dv


def pressure(stops: Stops, side: NDArray[np.int64], u: Array, velocity: Array) -> Array:
    """kappa d + c d' on the given sides, which are pressed: of size c d' at the entry too, where d is rounding."""
    depth = u - np.where(side > 0, stops.upper_bound, stops.lower_bound)
    return np.maximum(side * (float(stops.stiffness) * depth + float(stops.damping) * velocity), 0.0)


def peak_between(force: Callable[[Array], Array], low: Array, high: Array) -> Array:
    """The largest value of ``force`` inside every [low, high], by the golden section."""
    for _ in range(SECTIONS):
        step = GOLDEN * (high - low)
        left, right = high - step, low + step
        rises = force(right) > force(left)
        low, high = np.where(rises, left, low), np.where(rises, high, right)
    return force(0.5 * (low + high))
