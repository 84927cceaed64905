"""Random systems marched in blocks and in leaps, and how closely the two have to agree."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import zip_longest

import numpy as np

import stiffbeam as sb
from stiffbeam.march import leap
from stiffbeam.march.block_march import March
from stiffbeam.march.integrate import Plan
from stiffbeam.march.propagator import build
from stiffbeam.schemes import registered

SCHEMES = list(registered())
# The exact flow with implicit contact gains energy at the stops; what grows past 1e100 has no digits to compare.
STABLE = [scheme for scheme in SCHEMES if not isinstance(scheme, sb.ExponentialFlow)]


def random_system(rng: np.random.Generator) -> sb.System:
    """A driven chain with one to three contacts, on one side or both, that moves on its own as well."""
    n = int(rng.integers(1, 9))
    springs = 10.0 ** rng.uniform(0.5, 3.0, n)
    stiffness = np.diag(springs + np.append(springs[1:], 0.0))
    stiffness -= np.diag(springs[1:], 1) + np.diag(springs[1:], -1)
    mass = np.diag(rng.uniform(0.5, 2.0, n))
    first = math.sqrt(np.min(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real))
    static = np.linalg.solve(stiffness, np.eye(n))[-1]
    reach = float(np.abs(static).max())
    loads = [
        (rng.normal(size=n), sb.Harmonic(rng.uniform(0.2, 2.0), first * rng.uniform(0.3, 2.5), rng.uniform(0, 6)))
        for _ in range(rng.integers(1, 4))
    ]
    if rng.random() < 0.5:
        loads.append((rng.normal(size=n), sb.Constant(rng.uniform(-0.5, 0.5))))
    contacts = []
    for c in range(min(n, int(rng.integers(1, 4)))):
        gap = reach * 10.0 ** rng.uniform(-1.5, 0.3, 2)
        sides = [(None, gap[1]), (-gap[0], None), (-gap[0], gap[1])][rng.integers(3)]
        stops = sb.Stops(*sides, stiffness=float(springs.max() * 10.0 ** rng.uniform(-0.5, 3.0)))
        moves = sb.Harmonic(0.2 * gap.min(), first * rng.uniform(0.3, 2.0), 0.0) if rng.random() < 0.3 else None
        contacts.append(sb.Contact(np.eye(n)[n - 1 - c], stops, moves))
    return sb.System.from_matrices(
        mass, stiffness, rng.choice([0.0, 0.05]) * first * mass, loads=loads, contacts=contacts,
        observe=rng.normal(size=n) if rng.random() < 0.5 else None,
        initial_displacement=0.3 * reach * rng.normal(size=n), initial_velocity=first * reach * rng.normal(size=n),
    )  # fmt: skip


def both(system: sb.System, scheme: sb.Scheme, dt: float, steps: int, every: int | None = None, since: int = 0):
    """(block march, leaping march) of one run, each flown to its end."""
    plan = Plan.of(system, scheme, dt, steps * dt, "implicit", 1, "numba")
    assert plan.stepper is not None
    found = []
    for kind in (March, leap.LeapMarch):
        march = kind(plan.stepper, (system,), plan.steps, every, since)
        for _ in march.advance():
            pass
        found.append(march)
    return found


def in_another_order(system: sb.System, scheme: sb.Scheme, dt: float, steps: int) -> March:
    """The block march with one step to a block: the same sums with another rounding."""
    stepper = Plan.of(system, scheme, dt, steps * dt, "implicit", 1, "numba").stepper
    assert stepper is not None
    one = build(scheme, stepper.coordinates, dt, 1, "implicit")
    march = March(replace(stepper, block=one), (system,), steps, None)
    for _ in march.advance():
        pass
    return march


def touches(march: March) -> list[tuple[float, int, float, float, float, float]]:
    """(time, contact, stop, end, peak, impulse) of the impacts of all contacts in order of time."""
    rows = []
    for c, contact in enumerate(march.seen(0).contacts):
        x = contact.impacts
        rows += zip(x.times, [c] * x.count, x.stops, x.ends, x.peaks, x.impulses, strict=True)
    return sorted(rows)


def compare(index: int) -> tuple[str, int]:
    """One random system; "leaps" or "blocks", and how many impacts were compared.

    Every impact multiplies rounding. How much is seen from block marches of initial data 1e-12 away and with
    one step to a block: the leaping march is compared as long as these differ by less than a thousandth of a
    step, and may differ by ten times as much.
    """
    rng = np.random.default_rng([16, index])
    system, scheme = random_system(rng), STABLE[index % len(STABLE)]
    omega = np.sqrt(np.max(np.linalg.eigvals(np.linalg.solve(system.mass, system.stiffness)).real))
    dt = float(10.0 ** rng.uniform(-3.0, 0.0) / omega)
    steps, every = int(rng.integers(2000, 20_000)), int(rng.integers(1, 200))
    blocks, leaps = both(system, scheme, dt, steps, every)
    if leaps.kind == leap.BLOCKS:
        return "blocks", 0
    moved = replace(system, q0=system.q0 * (1.0 + 1e-12), v0=system.v0 * (1.0 - 1e-12))
    beside = touches(both(moved, scheme, dt, steps)[0])
    ordered = touches(in_another_order(system, scheme, dt, steps))
    grown, compared, calm = 1e-7, 0, dt * steps
    for a, b, c, d in zip_longest(touches(blocks), touches(leaps), beside, ordered):
        if a is not None and c is not None and d is not None and a[1:3] == c[1:3] == d[1:3]:
            now = max(grown, abs(a[0] - c[0]) / dt, abs(a[0] - d[0]) / dt)
        else:
            now = math.inf
        if now > 1e-3:
            calm = min(x[0] for x in (a, b, c, d) if x is not None)
            break
        grown = now
        assert a is not None
        assert b is not None
        assert a[1:3] == b[1:3]
        assert abs(a[0] - b[0]) <= 10.0 * grown * dt + 1e-13 * dt * steps
        # The same step, but for one that begins within the difference.
        assert math.floor(a[0] / dt) == math.floor(b[0] / dt) or abs(a[0] / dt - round(a[0] / dt)) < 0.02
        assert math.isnan(a[3]) == math.isnan(b[3]) or a[0] > 0.9 * dt * steps
        ends = [x[3] for x in (a, b, c, d) if x is not None]
        if np.all(np.isfinite(ends)):
            parted = max(grown, abs(ends[0] - ends[2]) / dt, abs(ends[0] - ends[3]) / dt)
            assert abs(ends[0] - ends[1]) <= 10.0 * parted * dt + 1e-13 * dt * steps
        for own, other in zip(a[4:], b[4:], strict=True):
            assert math.isnan(own) == math.isnan(other) or a[0] > 0.9 * dt * steps
            if not math.isnan(own) and not math.isnan(other):
                assert abs(own - other) <= 1e4 * grown * own
        compared += 1
    until = int(calm / (dt * every))
    for name in ("tip", "tip_velocity"):
        own, other = (getattr(x.seen(0), name) for x in (blocks, leaps))
        assert np.max(np.abs(own - other)[:until], initial=0.0) <= 10.0 * grown * np.max(np.abs(own))
    if calm == dt * steps:
        for x, y in zip(blocks.seen(0).contacts, leaps.seen(0).contacts, strict=True):
            assert x.fraction == y.fraction
            assert abs(x.peak_force - y.peak_force) <= 1e4 * grown * x.peak_force
            assert abs(x.impulse - y.impulse) <= 1e4 * grown * x.impulse
    return "leaps", compared


def campaign(indices: range) -> None:
    found = [compare(index) for index in indices]
    assert sum(kind == "leaps" for kind, _ in found) >= 0.8 * len(found)
    assert sum(count for _, count in found) >= 3 * len(found)
