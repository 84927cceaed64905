"""One mass that meets a damped or a power-law stop, in closed form or by quadrature, in mpmath."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath as mp
from truth import Span, Truth, free, from_spans


def kelvin_voigt(m: Any, kappa: Any, c: Any, u0: Any, v0: Any, t_end: float, samples: int) -> Truth:
    """A free mass from u0 < 0 at v0 against a spring and damper that push only, at u >= 0.

    m x'' + c x' + kappa x = 0 from x = 0, x' = v0; the force kappa x + c x' is zero again at
    t = [pi - atan2(2 zeta r, 1 - 2 zeta^2)]/(w r), r = sqrt(1 - zeta^2), while x is still positive.
    """
    m, kappa, c, u0, v0 = map(mp.mpf, (m, kappa, c, u0, v0))
    w = mp.sqrt(kappa / m)
    zeta = c / (2 * w * m)
    root = mp.sqrt(1 - zeta**2)
    wd = w * root
    duration = (mp.pi - mp.atan2(2 * zeta * root, 1 - 2 * zeta**2)) / wd
    entry = -u0 / v0

    def pressed(s: Any) -> tuple[Any, Any]:
        decay, sine, cosine = mp.exp(-zeta * w * s), mp.sin(wd * s), mp.cos(wd * s)
        return v0 * decay * sine / wd, v0 * decay * (cosine - zeta / root * sine)

    x, v = pressed(duration)
    assert abs(kappa * x + c * v) < mp.mpf(10) ** -45 * kappa
    spans = [Span(mp.mpf(0), free(u0, v0)), Span(entry, pressed), Span(entry + duration, free(x, v))]
    u, rate = from_spans(spans, t_end, samples)
    # Force/v0 = e^{-zeta w s} [c cos + (kappa/wd - c zeta/r) sin] is a sine again, largest a quarter period and a
    # decay's phase before it is zero.
    sine = kappa / wd - c * zeta / root
    top = (mp.atan2(sine, c) - mp.atan2(zeta, root)) / wd
    peak = max(c * v0, sum(a * b for a, b in zip((kappa, c), pressed(top), strict=True)) if top > 0 else 0)
    energy = (m * v * v / 2, m * v0 * v0 / 2, "m v^2/2 of the free mass after release")
    how = "closed form of the damped oscillator, from the entry to the time at which its force is zero"
    return Truth(how, u, rate, [entry], [entry + duration], peak, energy, {
        "restitution": (-v / v0, "exp(-zeta w t) at the release"),
        "contact_time": (duration, "[pi - atan2(2 zeta r, 1 - 2 zeta^2)]/(w r), r = sqrt(1 - zeta^2)"),
        "naive_restitution": (mp.exp(-zeta * mp.pi / root), "of a damper that may pull, released at x = 0"),
    })  # fmt: skip


def moving_dashpot(system: dict[str, Any], t_end: float, samples: int) -> Truth:
    """One mass m on a spring k and a stop (kappa, c) at u + o(t) = g, o(t) = a sin(w t + phi), that pushes only.

    In contact m u'' + c u' + (k + kappa) u = kappa (g - o) - c o'. The free motion has kappa = c = 0. Each is the sum
    of a constant, the response to o and two exponentials. Contact begins at u + o = g, and ends where the force is 0.
    """
    contact = system["contacts"][0]
    (m,), (k,) = system["mass"][0], system["stiffness"][0]
    m, k, kappa, c, g = (mp.mpf(x) for x in (m, k, *(contact[x] for x in ("stiffness", "damping", "upper"))))
    a, w, phi = (mp.mpf(contact["offset"][x]) for x in ("amplitude", "frequency", "phase"))

    def turning(t: Any) -> Any:
        return a * mp.expj(w * t + phi)  # its imaginary part is o

    def path(t: Any, u: Any, v: Any, kappa: Any, c: Any) -> Callable[[Any], tuple[Any, Any]]:
        response, rest = -(kappa + 1j * w * c) / (k + kappa - m * w**2 + 1j * w * c), kappa * g / (k + kappa)
        root = mp.sqrt(c**2 / (4 * m**2) - (k + kappa) / m)
        r, q = -c / (2 * m) + root, -c / (2 * m) - root
        u -= mp.im(response * turning(t)) + rest
        v -= mp.im(1j * w * response * turning(t))
        one, two = (v - q * u) / (r - q), (r * u - v) / (r - q)

        def at(s: Any) -> tuple[Any, Any]:
            driven, left, right = response * turning(t + s), one * mp.exp(r * s), two * mp.exp(q * s)
            return (mp.im(driven) + rest + mp.re(left + right),
                    mp.im(1j * w * driven) + mp.re(r * left + q * right))  # fmt: skip

        return at

    t, closed, peak = mp.mpf(0), False, mp.mpf(0)
    u, v = (mp.mpf(system[f"initial_{x}"][0]) for x in ("displacement", "velocity"))
    spans, events = list[Span](), (list[Any](), list[Any]())
    while True:
        at = path(t, u, v, *((kappa, c) if closed else (0, 0)))
        spans.append(Span(t, at))

        def law(s: Any, t: Any = t, at: Any = at) -> tuple[Any, Any]:
            """Depth and force; the stop pushes while both are positive."""
            (u, v), o = at(s), turning(t + s)
            depth = u + mp.im(o) - g
            return depth, kappa * depth + c * (v + mp.im(1j * w * o))

        def over(s: Any, law: Any = law, sign: int = 1 if closed else -1) -> Any:
            return sign * min(law(s))

        step = min(1 / mp.sqrt((k + kappa) / m), 1 / w) / 64
        s = step
        while over(s) > 0 and t + s < t_end:
            s += step
        if closed:
            times = mp.linspace(0, s, 129)
            top = max(times, key=lambda s: law(s)[1])
            inside = 0 < top < s
            peak = max(peak, law(mp.findroot(lambda s: mp.diff(lambda x: law(x)[1], s), top) if inside else top)[1])
        if t + s >= t_end:
            break
        s = mp.findroot(over, (s - step, s), solver="anderson", tol=mp.mpf(10) ** -90)
        t, (u, v) = t + s, at(s)
        events[closed].append(t)
        closed = not closed
    tip, rate = from_spans(spans, t_end, samples)
    how = "closed form of the oscillator between events, these by root finding (mpmath)"
    return Truth(how, tip, rate, events[0], events[1], peak)


def hunt_crossley(m: Any, kappa: Any, p: Any, dissipation: Any, u0: Any, v0: Any, t_end: float, samples: int) -> Truth:
    """m d'' = -kappa d^p (1 + lambda d') from u0 < 0 at v0; lambda = 0 is Hertz' power law.

    With G(v) = v/lambda - ln(1 + lambda v)/lambda^2 (v^2/2 for lambda = 0) the depth at speed v is
    d^(p+1) = (p + 1) m/kappa [G(v0) - G(v)], and time passes as dt = -dv m/(kappa d^p (1 + lambda v)).
    """
    m, kappa, p, lam, u0, v0 = map(mp.mpf, (m, kappa, p, dissipation, u0, v0))
    q, e = p + 1, mp.mpf(1)
    if lam:
        x = lam * v0
        e = (1 + mp.lambertw(-(1 + x) * mp.exp(-(1 + x))).real) / x

    def G(v: Any) -> Any:
        return v / lam - mp.log(1 + lam * v) / lam**2 if lam else v * v / 2

    def depth(v: Any) -> Any:
        return max(q * m / kappa * (G(v0) - G(v)), mp.mpf(0)) ** (1 / q)

    def slope(w: Any, end: Any) -> Any:
        """dt/dw of v = end -+ w^q, away from the end of the contact with speed ``end``, v0 or -e v0.

        d ~ |end - v|^(1/q) there, so that t is smooth in w.
        """
        toward, loss = mp.sign(end), kappa * (1 + lam * end) / m
        if w < mp.eps ** (1 / (2 * q)):  # the next term is w^q smaller, and G(v0) - G(v) keeps half the digits
            return q / (q * m / kappa * abs(end) / (1 + lam * end)) ** (p / q) / loss
        v = end - toward * w**q
        return q * w**p * m / (kappa * depth(v) ** p * (1 + lam * v))

    def elapsed(w: Any, end: Any) -> Any:
        return mp.quad(lambda x: slope(x, end), mp.linspace(0, w, 5)) if w else w

    leave = -e * v0
    entry, half, rest = -u0 / v0, elapsed(v0 ** (1 / q), v0), elapsed(abs(leave) ** (1 / q), leave)
    duration = half + rest

    def pressed(s: Any) -> tuple[Any, Any]:
        end, whole, since = (v0, half, s) if s <= half else (leave, rest, duration - s)
        w = abs(end) ** (1 / q) * since / whole
        for _ in range(60):  # Newton's method
            step = (elapsed(w, end) - since) / slope(w, end)
            w = max(w - step, mp.mpf(0))
            if abs(step) <= mp.eps * 1000:
                v = end - mp.sign(end) * w**q
                return depth(v), v
        raise ArithmeticError(f"no speed found at {s} of the contact")

    spans = [Span(mp.mpf(0), free(u0, v0)), Span(entry, pressed), Span(entry + duration, free(mp.mpf(0), leave))]
    u, rate = from_spans(spans, t_end, samples)
    top = mp.mpf(0)  # the speed at which the force is largest: p v (1 + lambda v) + d lambda v' = 0
    if lam:
        top = mp.findroot(lambda v: p * v - lam * kappa / m * depth(v) ** q, (v0 / 1000, v0), solver="anderson")
    energy = (m * leave**2 / 2, m * v0**2 / 2, "m v^2/2 of the free mass after the impact")
    how = "depth from the first integral of the motion, time by quadrature over the velocity (mpmath)"
    return Truth(how, u, rate, [entry], [entry + duration], kappa * depth(top) ** p * (1 + lam * top), energy, {
        "restitution": (e, "(1 - y)/(lambda v), y = -W0(-(1 + lambda v) exp(-1 - lambda v)), whatever m, kappa and p"
                        if lam else "1: the law has a potential"),
        "contact_time": (duration, "quadrature" if lam else "2 sqrt(pi) Gamma(1 + 1/q)/Gamma(1/2 + 1/q) d_max/v, q = "
        "p + 1"),
        "largest_depth": (depth(mp.mpf(0)), "[q m/kappa (G(v) - G(0))]^(1/q), G = v/lambda - ln(1 + lambda v)/lambda^2"
                          if lam else "[q m v^2/(2 kappa)]^(1/q), q = p + 1"),
    })  # fmt: skip
