"""Motions against rigid stops with restitution, x'+ = -e x'-, in mpmath."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath as mp
from truth import Span, Truth, free, from_spans

LISTED = 12  # impacts of an infinite number that a file lists


def bouncing_ball(h: Any, g: Any, e: Any, t_end: float, samples: int) -> Truth:
    """From height h: flights last 2 v_k/g, v_k = e^k sqrt(2 g h), and end at t = sqrt(2h/g) (1 + e)/(1 - e)."""
    h, g, e = map(mp.mpf, (h, g, e))
    t, v = mp.sqrt(2 * h / g), mp.sqrt(2 * g * h)
    spans, impacts, last = [Span(mp.mpf(0), free(h, mp.mpf(0), -g))], [], t * (1 + e) / (1 - e)
    while v > mp.mpf(10) ** -50:
        impacts.append(t)
        v = e * v
        spans.append(Span(t, free(mp.mpf(0), v, -g)))
        t += 2 * v / g
    spans.append(Span(last, free(mp.mpf(0), mp.mpf(0))))
    u, w = from_spans(spans, t_end, samples)
    how = "parabolas between the impacts, a geometric series of flights, rest after it"
    return Truth(how, u, w, impacts[:LISTED], [], energy=(mp.mpf(0), g * h, "at rest; the load's energy is not "
        "counted"),
                 more={"accumulation": (last, "sqrt(2 h/g) (1 + e)/(1 - e)")})  # fmt: skip


def preloaded_chatter(c: Any, e: Any, t_end: float, samples: int) -> Truth:
    """x'' + x = c > 0, x <= 0, leaving x = 0 with -c: x = c (1 - cos s) - v sin s returns after 2 atan(v/c) at v."""
    c, e = mp.mpf(c), mp.mpf(e)
    t, v, spans, impacts = mp.mpf(0), c, [], []
    while v > mp.mpf(10) ** -50 * c:
        spans.append(Span(t, lambda s, v=v: (c * (1 - mp.cos(s)) - v * mp.sin(s), c * mp.sin(s) - v * mp.cos(s))))
        t += 2 * mp.atan2(v, c)
        impacts.append(t)
        v = e * v
    spans.append(Span(t, free(mp.mpf(0), mp.mpf(0))))
    u, w = from_spans(spans, t_end, samples)
    last = mp.nsum(lambda k: 2 * mp.atan(e**k), [0, mp.inf])
    assert abs(last - t) < mp.mpf(10) ** -35
    how = "closed form between the impacts, sum of 2 atan(e^k), rest after it"
    return Truth(how, u, w, impacts[:LISTED], [], energy=(mp.mpf(0), c * c / 2, "at rest on the stop at x = 0"),
                 more={"accumulation": (last, "sum over k >= 0 of 2 atan(e^k)")})  # fmt: skip


def sticking_phase() -> tuple[Any, Any, Any]:
    """(T_f, T_s, speed): m = k = 1, wall - m - m, u2 <= 1; the periodic motion that sticks once a period.

    While u2 = 1 is held u1'' = 1 - 2 u1, and the stop pushes as long as u1 > 1. It lets go at u1 = u2 = 1, u2' = 0,
    u1' = -speed, and the free flight that follows is even about T_f/2: a cos, b cos of the two modes with
    three conditions for a, b and T_f. Then u1 returns to 1 after T_s = sqrt(2) atan(sqrt(2) speed).
    """
    w = [(mp.sqrt(5) - 1) / 2, (mp.sqrt(5) + 1) / 2]
    shapes = [2 - x * x for x in w]  # u2 of the mode with u1 = 1

    def amplitudes(T: Any) -> tuple[Any, Any]:
        c = [mp.cos(x * T / 2) for x in w]
        a = mp.lu_solve(mp.matrix([[c[0], c[1]], [shapes[0] * c[0], shapes[1] * c[1]]]), mp.matrix([1, 1]))
        return a[0], a[1]

    def rate(T: Any, row: tuple[Any, Any]) -> Any:
        return mp.fsum(r * a * x * mp.sin(x * T / 2) for r, a, x in zip(row, amplitudes(T), w, strict=True))

    T = mp.findroot(lambda T: rate(T, (shapes[0], shapes[1])), (mp.mpf("5.9"), mp.mpf("6.0")), solver="anderson")
    speed = -rate(T, (mp.mpf(1), mp.mpf(1)))
    return T, mp.sqrt(2) * mp.atan(mp.sqrt(2) * speed), speed


def _rising(f: Callable[[Any], Any], near: Any) -> Any:
    """The zero of f within 1e-3 of ``near``, by bisection: it may be a cube."""
    low, high = near - mp.mpf("1e-3"), near + mp.mpf("1e-3")
    assert f(low) < 0 < f(high)
    for _ in range(200):
        middle = (low + high) / 2
        low, high = (middle, high) if f(middle) < 0 else (low, middle)
    return high


def sticking(speed: float, t_end: float, samples: int) -> Truth:
    """The motion that leaves u1 = u2 = 1 with u1' = -speed, a double, u2' = 0: flights and rests one after the other.

    The orbit of ``sticking_phase`` arrives at u2 = 1 without speed; with the double next to its speed the second mass
    arrives a little earlier or later, since u2 - 1 is a cube there, at a speed of 1e-10 that e = 0 takes away.
    """
    T, stick, exact = sticking_phase()
    w = [(mp.sqrt(5) - 1) / 2, (mp.sqrt(5) + 1) / 2]
    shapes = [2 - x * x for x in w]
    r, half = mp.sqrt(2), mp.mpf(1) / 2

    def flight(v1: Any, which: int) -> Callable[[Any], tuple[Any, Any]]:
        """u_which from (1, 1) with (v1, 0)."""
        a = mp.lu_solve(mp.matrix([[1, 1], shapes]), mp.matrix([1, 1]))
        b = mp.lu_solve(mp.matrix([[1, 1], shapes]), mp.matrix([v1, 0]))
        row = (1, 1) if which == 1 else shapes

        def at(s: Any) -> tuple[Any, Any]:
            u = [a[j] * mp.cos(w[j] * s) + b[j] / w[j] * mp.sin(w[j] * s) for j in (0, 1)]
            v = [b[j] * mp.cos(w[j] * s) - a[j] * w[j] * mp.sin(w[j] * s) for j in (0, 1)]
            return mp.fdot(row, u), mp.fdot(row, v)

        return at

    def held(u: Any, v: Any) -> Callable[[Any], tuple[Any, Any]]:
        """u1'' = 1 - 2 u1."""
        return lambda s: (half + (u - half) * mp.cos(r * s) + v / r * mp.sin(r * s),
                          v * mp.cos(r * s) - (u - half) * r * mp.sin(r * s))  # fmt: skip

    t, v1, spans, arrivals, departures = mp.mpf(0), -mp.mpf(speed), [], [], []
    while t < t_end:
        one, two = flight(v1, 1), flight(v1, 2)
        s = _rising(lambda s, two=two: two(s)[0] - 1, T)
        rest = held(*one(s))
        gone = _rising(lambda s, rest=rest: 1 - rest(s)[0], stick)
        spans += [Span(t, one), Span(t + s, rest)]
        arrivals.append(t + s)
        departures.append(t + s + gone)
        t, v1 = t + s + gone, rest(gone)[1]
    u, v = from_spans(spans, t_end, samples)
    E = mp.mpf(speed) ** 2 / 2 + half
    orbit = "of the orbit, whose speed no double has"
    return Truth(
        "flights in modes and rests in closed form, arrivals and departures by root finding (mpmath)", u, v, None, [],
        energy=(E, E, "conserved to 1e-19"),
        more={"arrivals": ([x for x in arrivals if x < t_end], "at a speed below 1e-9, so that they are no impacts"),
              "departures": ([x for x in departures if x < t_end], "where the contact force vanishes"),
              "period": (T + stick, f"free flight plus sticking, {orbit}"),
              "free_flight": (T, f"u2'(0) = 0 of an even flight, {orbit}"),
              "sticking_time": (stick, f"sqrt(2) atan(sqrt(2) speed), {orbit}"),
              "speed": (exact, f"|u1'| at the release, {orbit}")},
    )  # fmt: skip


def rigid_motion(
    M: Any, K: Any, q0: Any, v0: Any, row: Any, stop: float, e: float, t_end: float, samples: int,
    drive: tuple[Any, float, float, float] | None = None, observe: Any = None,
) -> Truth:  # fmt: skip
    """M q'' + K q = p A sin(w t + phi) with row q <= stop and restitution e, from switch to switch in modes.

    Every number is the double it is. drive: (p, A, w, phi). A crossing is looked for on a grid of a 60th of the
    fastest period and refined; a motion that touches between two points of it would be missed.
    """
    n = len(M)
    mass, stiff = (mp.matrix([[mp.mpf(float(x)) for x in line] for line in A]) for A in (M, K))
    L = mp.cholesky(mass)
    inverse = L**-1
    values, vectors = mp.eigsy(inverse * stiff * inverse.T)
    shapes = inverse.T * vectors  # columns, M-orthonormal
    omega = [mp.sqrt(max(x, mp.mpf(0))) for x in values]
    assert all(w > mp.mpf(10) ** -20 for w in omega)
    to_modal = shapes.T * mass
    column = lambda x: mp.matrix([mp.mpf(float(y)) for y in x])  # noqa: E731
    seen, modal_row = (shapes.T * column(x) for x in (row if observe is None else observe, row))
    kick = [modal_row[j] / mp.fsum(x * x for x in modal_row) for j in range(n)]
    gain, w, phase = [mp.mpf(0)] * n, mp.mpf(1), mp.mpf(0)
    if drive is not None:
        p, A, w, phase = drive[0], *map(mp.mpf, drive[1:])
        force = shapes.T * column(p)
        gain = [force[j] * A / (omega[j] ** 2 - w * w) for j in range(n)]
    h, rate = list(to_modal * column(q0)), list(to_modal * column(v0))
    t, spans, impacts = mp.mpf(0), [], []

    def path(begin: Any, a: list[Any], b: list[Any], weights: Any) -> Callable[[Any], tuple[Any, Any]]:
        def at(s: Any) -> tuple[Any, Any]:
            q, v = states(begin, a, b, s)
            return mp.fdot(weights, q), mp.fdot(weights, v)

        return at

    def states(begin: Any, a: list[Any], b: list[Any], s: Any) -> tuple[list[Any], list[Any]]:
        now, then = (mp.sin(w * x + phase) for x in (begin + s, begin))
        now_rate, then_rate = (w * mp.cos(w * x + phase) for x in (begin + s, begin))
        q, v = [], []
        for j in range(n):
            x, y = a[j] - gain[j] * then, b[j] - gain[j] * then_rate
            cosine, sine = mp.cos(omega[j] * s), mp.sin(omega[j] * s)
            q.append(x * cosine + y * sine / omega[j] + gain[j] * now)
            v.append(y * cosine - x * omega[j] * sine + gain[j] * now_rate)
        return q, v

    step = float(2 * mp.pi / max([*omega, w]) / 60)
    while True:
        spans.append(Span(t, path(t, h, rate, list(seen))))
        look = path(t, h, rate, list(modal_row))
        s, crossed = 0.0, None
        with mp.workdps(20):
            while crossed is None and t + s <= t_end:
                crossed = (s, s + step) if s > 0.0 and look(mp.mpf(s + step))[0] > stop else None
                s += step
        if crossed is None:
            break
        s = mp.findroot(lambda x, look=look: look(x)[0] - stop, crossed, solver="anderson", tol=1e-100)
        if t + s > t_end:
            break
        h, rate = states(t, h, rate, s)
        t, speed = t + s, mp.fdot(list(modal_row), rate)
        rate = [b - (1 + mp.mpf(e)) * speed * k for b, k in zip(rate, kick, strict=True)]
        impacts.append(t)
    u, v = from_spans(spans, t_end, samples)
    energies = [mp.fsum((b * b + (x * a) ** 2) / 2 for a, b, x in zip(*states(p.begin, *s, z), omega, strict=True))
                for p, s, z in [(spans[-1], (h, rate), mp.mpf(t_end) - spans[-1].begin)]]  # fmt: skip
    start = mp.fsum(
        (b * b + (x * a) ** 2) / 2 for a, b, x in zip(to_modal * column(q0), to_modal * column(v0), omega, strict=True)
    )
    scale = max(start, energies[0], max(x * x for x in v) / 2 if n == 1 else start)
    how = "modes in closed form between the impacts, impacts by root finding (mpmath)"
    return Truth(how, u, v, impacts, [], energy=(energies[0], scale, "of the state at t_end"))
