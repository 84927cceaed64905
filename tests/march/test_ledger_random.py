"""The compiled ledger and the kept velocities of random runs, against the states at every step."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.march import replay
from stiffbeam.model.time_functions import offset_rate, offset_values
from stiffbeam.schemes import registered
from stiffbeam.trajectory.records import Ledger, step_ledger

LAWS = [{}, {}, {"damping": 3.0}, {"dissipation": 0.3}, {"exponent": 1.5}]
SCHEMES = list(registered())
EVERY = [1, 1, 7, 32, 33, 100]


def random_run(rng: np.random.Generator) -> sb.Trajectory:
    """A chain with up to four contacts of any law, stops that move or not, up to three loads of any kind."""
    n, m = int(rng.integers(1, 12)), int(rng.integers(0, 5))
    mass, springs = np.diag(rng.uniform(0.5, 2.0, n)), 10.0 ** rng.uniform(0.5, 3.0, n)
    stiffness = np.diag(springs + np.append(springs[1:], 0.0)) - np.diag(springs[1:], 1) - np.diag(springs[1:], -1)
    damping = rng.integers(0, 2) * (rng.uniform(0.0, 0.1) * mass + rng.uniform(0.0, 1e-3) * stiffness)
    slow = float(np.sqrt(np.min(np.linalg.eigvals(stiffness / np.diag(mass)[:, None]).real)))
    size = float(np.mean(springs))

    def function() -> object:
        wave = sb.Harmonic(rng.normal(), rng.uniform(0.3, 3.0) * slow, phase=rng.uniform(0.0, 6.0))
        samples = sb.Sampled(np.linspace(0.0, 200.0 / slow, 401), rng.normal(size=401), kind="linear")
        return [sb.Constant(rng.normal()), wave, sb.Superposition(wave, sb.Constant(rng.normal())), samples][
            rng.integers(4)
        ]

    contacts = []
    for _ in range(m):
        stiff, law = 10.0 ** rng.uniform(1.0, 4.0) * size / 30.0, LAWS[rng.integers(len(LAWS))]
        stops = sb.Stops(-rng.uniform(0.1, 1.0), rng.uniform(0.1, 1.0), stiffness=stiff, **law)
        offset = sb.Harmonic(0.1, rng.uniform(0.3, 3.0) * slow) if rng.random() < 0.3 else None
        contacts.append(sb.Contact(rng.normal(size=n), stops, offset))
    system = sb.System.from_matrices(
        mass, stiffness, damping, loads=[(size * rng.normal(size=n), function()) for _ in range(rng.integers(0, 4))],
        contacts=contacts, observe=None if m else np.eye(n)[0], initial_displacement=0.5 * rng.normal(size=n),
        initial_velocity=rng.normal(size=n),
    )  # fmt: skip
    scheme, every = SCHEMES[rng.integers(len(SCHEMES))], EVERY[rng.integers(len(EVERY))]
    contact = "implicit" if rng.random() < 0.8 else ["extrapolated", "conserving"][rng.integers(2)]
    dt, steps = rng.uniform(0.002, 0.05) / slow, int(rng.integers(33, 400))
    return sb.integrate(system, scheme, dt, steps * dt, contact=contact, every=every)


@pytest.mark.parametrize("short", [1, 10**9])
@pytest.mark.parametrize("seed", range(20))
@pytest.mark.fast(4)
def test_ledger_and_velocities_are_those_of_the_states(seed, short, monkeypatch):
    """Ten runs each, with blocks without forces at once and step by step; what blows up has no energy to compare.

    Sums of 400 steps of stiff systems lose up to 1e-11 of their largest column, positions and velocities 3e-12.
    """
    monkeypatch.setattr(replay, "SHORT", short)
    rng, compared = np.random.default_rng([seed, 11]), 0
    while compared < 10:
        try:
            run = random_run(rng)
        except (sb.Diverged, sb.SolverFailure, sb.InputError):  # a scheme that does not take this law or step
            continue
        if run.provenance["march"] != "modal blocks" or np.max(np.abs(run.tip)) > 1e6:
            continue
        own, other = run.energy, step_ledger(run.system, run.pieces(), run.t)
        columns = [(getattr(own, f.name), getattr(other, f.name)) for f in fields(Ledger)[1:]]
        size = max(np.max(np.abs(x)) for _, x in columns)
        assert max(np.max(np.abs(a - b)) for a, b in columns) < 1e-9 * size, run
        q, v = run.states
        for (row, offset), seen in zip(run.system.channels, run.contacts, strict=False):
            u, rate = q @ row + offset_values(offset, run.t), v @ row + offset_rate(offset, run.t)
            for found, x, part in ((seen.position, u, q), (seen.velocity, rate, v)):
                off = np.max(np.abs(found - x)[1:], initial=0.0)  # what is given at t = 0 is not made of modes
                assert off < 1e-10 * np.max(np.abs(part)) * np.sum(np.abs(row)), run
        compared += 1
