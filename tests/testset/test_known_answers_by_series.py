"""The answers of the piecewise-linear problems to all their digits, by a third way: Taylor series in whole numbers.

    q'' = -M^-1 (K q + C q') + sum M^-1 p f(t) - sum kappa M^-1 row (row q + o(t) - g),  c_k = q^(k) h^k / k!

c_{k+2} (k+1)(k+2) = h^2 times the right-hand side of c_k, in numbers that are multiples of 2^-BITS; from switch to
switch. Nothing here comes from the package, nor from the other witnesses.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

mp = pytest.importorskip("mpmath")
FOLDER = Path(__file__).parents[2] / "reference" / "problems"
FILES = {file.stem: tomllib.loads(file.read_text(encoding="utf-8")) for file in FOLDER.glob("*.toml")}
LAWS = {"exponent", "damping", "dissipation"}
LINEAR = [
    name
    for name, file in FILES.items()
    if all(c["stiffness"] < float("inf") and not LAWS & c.keys() for c in file["system"]["contacts"])
]
LONG = {"stop-along-the-beam", "table10", "table12", "table14"}  # 90 s
BITS, ORDER, RADIANS = 200, 64, 6.0  # a step turns the fastest motion by RADIANS: 6^64/64! = 5e-40
CELLS = 24  # in which a step is searched for a switch
ONE = 1 << BITS


def whole(x):
    return int(mp.floor(mp.mpf(x) * ONE + mp.mpf("0.5")))


def matrix(given):
    if not isinstance(given, dict):
        return mp.matrix(given)
    bands = given["bands"]
    made = mp.matrix(len(bands[0]))
    for k, band in enumerate(bands):
        for i, value in enumerate(band):
            made[i, i + k] = made[i + k, i] = mp.mpf(value)
    return made


def sparse(vector):
    """(index, whole number) of what is not zero."""
    return [(i, whole(x)) for i, x in enumerate(vector) if x]


def wave(f, t, h):
    """f^(k)(t) h^k/k! of a time function, k = 0 .. ORDER, as whole numbers; a line is the one that begins at t."""
    if f is None or "constant" in f:
        return [whole(f["constant"]) if f else 0, *ORDER * [0]]
    if "times" in f:
        i = max(k for k, begin in enumerate(f["times"][:-1]) if mp.mpf(begin) <= t)
        (a, b), (x, y) = f["times"][i : i + 2], f["values"][i : i + 2]
        slope = (mp.mpf(y) - x) / (mp.mpf(b) - a)
        return [whole(x + slope * (t - a)), whole(slope * h), *(ORDER - 1) * [0]]
    turned, omega = mp.mpf(f["frequency"]) * t + f["phase"], mp.mpf(f["frequency"])
    quarter, size, made = [mp.sin(turned), mp.cos(turned), -mp.sin(turned), -mp.cos(turned)], mp.mpf(f["amplitude"]), []
    for k in range(ORDER + 1):
        made.append(whole(size * quarter[k % 4]))
        size *= omega * h / (k + 1)
    return made


def value(polynomial, x, derivative=0):
    """A polynomial with whole coefficients, or its derivative, at the number x."""
    total = mp.mpf(0)
    for k in range(len(polynomial) - 1, derivative - 1, -1):
        total = total * x + polynomial[k] * (k if derivative else 1)
    return total / ONE


def root(polynomial, low, high):
    """Where a polynomial that changes sign in [low, high] does: halved, then by Newton's method."""
    rising = value(polynomial, high) > 0
    for _ in range(12):
        middle = (low + high) / 2
        low, high = (low, middle) if (value(polynomial, middle) > 0) == rising else (middle, high)
    x = (low + high) / 2
    for _ in range(8):
        x -= value(polynomial, x) / value(polynomial, x, 1)
    return x


def signs(polynomial, end):
    """The polynomial in float64 at the ends of the cells of [0, end], and those ends."""
    at = np.linspace(0.0, float(end), CELLS + 1)
    return np.polynomial.polynomial.polyval(at, [k / ONE for k in polynomial]), at


@dataclass
class Contact:
    row: list
    push: list  # kappa h^2 M^-1 row
    kappa: object
    stops: dict  # side: g
    offset: dict | None


@dataclass
class Motion:
    """The motion of a file, followed to its end."""

    file: dict
    tip: list = field(default_factory=list)
    velocity: list = field(default_factory=list)
    switches: list = field(default_factory=list)  # time, contact, side after
    peak: object = 0
    energy: object = None

    def __post_init__(self):
        data = self.file["system"]
        M, K = matrix(data["mass"]), matrix(data["stiffness"])
        inverse = M**-1
        rows = [mp.matrix(c["row"]) for c in data["contacts"]]
        self.A, self.n = inverse * K, M.rows
        stiffest = self.A.copy()
        for c, row in zip(data["contacts"], rows, strict=True):
            stiffest += c["stiffness"] * (inverse * row) * row.T
        fastest = float(np.sqrt(np.max(np.linalg.eigvals(np.array(stiffest.tolist(), float)).real)))
        self.h = h = mp.mpf(RADIANS / fastest)
        self.loads = [(sparse(h * h * (inverse * mp.matrix(load["vector"]))), load) for load in data.get("loads", ())]
        self.contacts = [
            Contact(
                sparse(row), sparse(c["stiffness"] * h * h * (inverse * row)), mp.mpf(c["stiffness"]),
                {s: mp.mpf(c[name]) for s, name in ((1, "upper"), (-1, "lower")) if name in c}, c.get("offset"),
            )
            for c, row in zip(data["contacts"], rows, strict=True)
        ]  # fmt: skip
        self.observed = sparse(mp.matrix(data["observe"])) if "observe" in data else self.contacts[0].row
        self.free = [[(j, whole(h * h * self.A[i, j])) for j in range(self.n) if self.A[i, j]] for i in range(self.n)]
        C = inverse * matrix(data["damping"]) if "damping" in data else mp.matrix(self.n)
        self.drag = [[(j, whole(h * C[i, j])) for j in range(self.n) if C[i, j]] for i in range(self.n)]
        self.kinks = sorted({mp.mpf(t) for _, load in self.loads for t in load.get("times", ())})
        self.end = mp.mpf(self.file["t_end"])
        q, v = ([mp.mpf(x) for x in data[name]] for name in ("initial_displacement", "initial_velocity"))
        self._follow([whole(x) for x in q], [whole(x * h) for x in v])
        q, v = (mp.matrix([mp.mpf(x) / ONE for x in half]) for half in (self.q, self.v))
        self.energy = (v.T * M * v)[0] / (2 * h * h) + (q.T * K * q)[0] / 2
        for c, side in zip(self.contacts, self.sides, strict=True):
            u = sum(x * q[i] for i, x in c.row) / ONE + mp.mpf(wave(c.offset, self.end, h)[0]) / ONE
            self.energy += c.kappa * (u - c.stops[side]) ** 2 / 2 if side else 0

    def _series(self, t, q, v):
        """c_k of the piece at time t, (ORDER + 1, n), and the positions of the contacts."""
        offsets = [wave(c.offset, t, self.h) for c in self.contacts]
        given = [(p, wave(f, t, self.h)) for p, f in self.loads]
        for c, side, o in zip(self.contacts, self.sides, offsets, strict=True):
            if side:
                given.append(([(i, -x) for i, x in c.push], [o[0] - whole(c.stops[side]), *o[1:]]))
        pressed = [c for c, side in zip(self.contacts, self.sides, strict=True) if side]
        series = [q, v]
        for k in range(ORDER - 1):
            here, force = series[k], self.n * [0]
            for vector, f in given:
                for i, x in vector:
                    force[i] += x * f[k]
            for c in pressed:
                u = sum(x * here[j] for j, x in c.row) >> BITS
                for i, x in c.push:
                    force[i] -= x * u
            for i in range(self.n):
                force[i] -= sum(x * here[j] for j, x in self.free[i])
                force[i] -= (k + 1) * sum(x * series[k + 1][j] for j, x in self.drag[i])
            below = (k + 1) * (k + 2) << BITS
            series.append([x // below for x in force])
        return series, [self._seen(series, c.row, o) for c, o in zip(self.contacts, offsets, strict=True)]

    @staticmethod
    def _seen(series, row, offset):
        return [(sum(x * here[i] for i, x in row) >> BITS) + o for here, o in zip(series, offset, strict=True)]

    def _follow(self, q, v):
        t, self.sides = mp.mpf(0), len(self.contacts) * [0]
        _, gaps = self._series(t, q, v)
        on = {}  # contacts exactly on a stop, whose gap has a zero at the start of the step
        for i, (c, u) in enumerate(zip(self.contacts, gaps, strict=True)):
            for side, g in c.stops.items():
                beyond = side * (u[0] - whole(g))
                on |= {i: side} if beyond == 0 else {}
                self.sides[i] = side if beyond > 0 or (beyond == 0 and side * u[1] > 0) else self.sides[i]
        count = self.file["samples"]
        times = [mp.mpf(k * self.file["t_end"] / count) for k in range(1, count + 1)]
        while t < self.end:
            series, gaps = self._series(t, q, v)
            until = min([self.end, t + self.h, *(kink for kink in self.kinks if kink > t)])
            last, switch = (until - t) / self.h, None
            for i, (c, u) in enumerate(zip(self.contacts, gaps, strict=True)):
                for side, g in c.stops.items():
                    if self.sides[i] in (0, side):
                        gap = [u[0] - whole(g), *u[1:]]
                        if on.get(i) == side:
                            gap = gap[1:]  # divided by the time
                        seen, at = signs(gap, last)
                        away = np.flatnonzero(seen * (side if self.sides[i] else -side) < 0.0)
                        if len(away):
                            k = max(1, int(away[0]))
                            last, switch = root(gap, mp.mpf(at[k - 1]), mp.mpf(at[k])), (i, side)
            self._look(series, gaps, last)
            tip = self._seen(series, self.observed, wave(self._tip_offset, t, self.h))
            while times and times[0] <= (until if switch is None else t + last * self.h):
                x = (times.pop(0) - t) / self.h
                self.tip.append(value(tip, x))
                self.velocity.append(value(tip, x, 1) / self.h)
            columns = list(zip(*series, strict=True))
            q, v = [whole(value(c, last)) for c in columns], [whole(value(c, last, 1)) for c in columns]
            t, on = (until if switch is None else t + last * self.h), {}
            if switch:
                i, side = switch
                self.sides[i], on = (0 if self.sides[i] else side), {i: side}
                self.switches.append((t, i, self.sides[i]))
        self.q, self.v = q, v

    @property
    def _tip_offset(self):
        return None if "observe" in self.file["system"] else self.contacts[0].offset

    def _look(self, series, gaps, last):
        """The largest force of the first contact in a step."""
        side, u = self.sides[0], gaps[0]
        if side:
            rate = [k * u[k] for k in range(1, len(u))]
            seen, at = signs(rate, last)
            turns = np.flatnonzero((seen[1:] > 0.0) != (seen[:-1] > 0.0))
            places = [mp.mpf(0), last, *(root(rate, mp.mpf(at[k]), mp.mpf(at[k + 1])) for k in turns)]
            c = self.contacts[0]
            self.peak = max([self.peak, *(c.kappa * side * (value(u, x) - c.stops[side]) for x in places)])


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.campaign if name in LONG else pytest.mark.slow) for name in LINEAR]
)
def test_every_digit_of_the_piecewise_linear_answers(name):
    """30 digits are written: the last is right to less than one unit of the largest value."""
    file = FILES[name]
    with mp.workdps(70):
        found, answers = Motion(file), file["answers"]
        entered = [t for t, i, side in found.switches if i == 0 and side]
        left = [t for t, i, side in found.switches if i == 0 and not side]
        values = {
            "tip": found.tip, "tip_velocity": found.velocity, "impacts": entered, "releases": left,
            "peak_force": [found.peak] if found.peak else [], "energy": [found.energy],
        }  # fmt: skip
        for what, mine in values.items():
            listed = answers.get(what, {"value": []})["value"]
            known = [mp.mpf(x) for x in (listed if isinstance(listed, list) else [listed])]
            assert len(mine) == len(known), what
            digits = 11 if "11 digits" in answers.get(what, {"how": ""})["how"] else 30
            largest = max((abs(x) for x in known), default=mp.mpf(0))
            unit = mp.mpf(10) ** (mp.floor(mp.log10(largest)) + 1 - digits) if largest else mp.mpf(0)
            assert all(abs(a - b) < unit for a, b in zip(mine, known, strict=True)), what
