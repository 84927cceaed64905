"""A random system as the package takes it, and a run of a scheme against the plain loop."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np
import plain_march
from step_loops import STEPS, march
from vibro_impact import Case, Wave, wave_value

import stiffbeam as sb
from stiffbeam.schemes import registered

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # nodes beyond the step are meant
    # Every registered scheme, and parameters that only the campaign tries.
    SCHEMES: list[sb.Scheme] = [*registered(), sb.SDIRK(0.3, nystrom=True), sb.Bathe(split=0.7), sb.Theta(theta=0.8)]


@dataclass(frozen=True)
class Verdict:
    """``outcome`` of ``subject``, a method or a scheme; ``reason``: what is wrong, or why it was refused.

    difference: largest |du| inside the horizon over max |u|, from the true motion or between references; horizon:
    as a share of the span. NaN where neither was measured.
    """

    outcome: str
    subject: str
    reason: str = ""
    difference: float = float("nan")
    horizon: float = float("nan")


class Pulse:
    """A pulse as a user writes it: a function of time that states where it is not smooth."""

    def __init__(self, wave: Wave) -> None:
        self.wave = wave
        _, _, begin, end = wave
        self.breakpoints = (begin, 0.5 * (begin + end), end)

    def __call__(self, t):
        return wave_value(self.wave, t)


def function_of(wave: Wave):
    if wave[0] == "constant":
        return sb.Constant(wave[1])
    return sb.Harmonic(*wave[1:]) if wave[0] == "harmonic" else Pulse(wave)


def system_of(case: Case) -> sb.System:
    contacts = [
        sb.Contact(
            c.row,
            sb.Stops(*(float(x) if np.isfinite(x) else None for x in (c.lower, c.upper)), stiffness=c.kappa),
            None if c.offset is None else function_of(c.offset),
        )
        for c in case.contacts
    ]
    loads = [(p, function_of(wave)) for p, wave in case.loads]
    start = {"initial_displacement": case.q0, "initial_velocity": case.v0}
    return sb.System.from_matrices(
        case.mass, case.stiffness, case.damping, loads, contacts, observe=case.observe, **start
    )


def _positions(
    case: Case, system: sb.System, scheme: sb.Scheme, dt: float, steps: int, contact: str, q0: np.ndarray
) -> np.ndarray:
    """Positions (steps + 1, n) from q0 by the plain loop. A scheme without one is marched with matrices: the plain
    march shares the formula of its step with the run that is judged, and nothing else."""
    if scheme.name in STEPS:
        return march(replace(case, q0=q0), scheme.name, scheme.parameters, dt, steps, contact)[0]
    return plain_march.march(replace(system, q0=q0), scheme, dt, steps * dt, contact).states[0]


def judge_scheme(case: Case, system: sb.System, rng: np.random.Generator) -> list[Verdict]:
    """One scheme and contact against the plain loop, while rounding allows; its impacts by the rule."""
    scheme = SCHEMES[int(rng.integers(len(SCHEMES)))]
    contact = str(rng.choice(["implicit", "implicit", "extrapolated"]))
    steps = int(rng.integers(50, 400))
    subject = f"{scheme} {contact}"
    dt = case.t_end / steps
    with np.errstate(all="ignore"):
        q = _positions(case, system, scheme, dt, steps, contact, case.q0.astype(float))
        # A hundred roundings: a change of one may be rounded away before it has grown.
        nudged = case.q0 * (1 + 1e-13) + 1e-14 * np.max(np.abs(q[np.isfinite(q)]), initial=0.0)
        other = _positions(case, system, scheme, dt, steps, contact, nudged)
    loop = q @ case.observe
    try:
        run = sb.integrate(system, scheme, dt, case.t_end, contact)
    except sb.Diverged as error:
        grown = np.max(np.abs(loop[np.isfinite(loop)]), initial=0.0)
        if np.all(np.isfinite(loop)) and grown < 1e6 * max(abs(loop[0]), abs(loop[1]), 1e-300):
            return [Verdict("wrong", subject, f"overflowed where the loop does not: {error}")]
        return [Verdict("refused", subject, str(error)[:200])]
    if not np.all(np.isfinite(run.tip)):
        return [Verdict("not finite", subject)]
    with np.errstate(all="ignore"):
        spread = np.maximum.accumulate(np.abs(loop - other @ case.observe))
        scale = np.maximum.accumulate(np.abs(loop))
        bad = np.flatnonzero(~(np.abs(run.tip - loop) <= 1e-8 * scale + 1e2 * spread))
    if len(bad) and np.isfinite(loop[bad[0]]):
        k = bad[0]
        return [Verdict("wrong", subject, f"step {k} of {steps}: {run.tip[k]:.12g}, the loop has {loop[k]:.12g}")]
    for i, record in enumerate(run.contacts):
        c, u = case.contacts[i], record.position
        chi = (u > c.upper).astype(int) - (u < c.lower).astype(int)
        if not chi[0]:  # a start on a stop that does not leave it is contact from t = 0
            chi[0] = int(u[0] == c.upper and record.velocity[0] >= 0.0) - int(
                u[0] == c.lower and record.velocity[0] <= 0.0
            )
        n = np.flatnonzero((chi[1:] != 0) & (chi[1:] != chi[:-1])) + 1
        if not np.array_equal(record.impacts.stops, chi[n]) or np.any(
            np.abs(record.impacts.times / dt - n + 0.5) > 0.5 + 1e-6
        ):
            return [Verdict("wrong", subject, f"contact {i}: impacts are not those of the positions")]
    return [Verdict("right", subject)]
