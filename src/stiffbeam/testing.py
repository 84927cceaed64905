"""Laws that every scheme and every solver obeys, as functions for tests of your own.

``check_scheme(scheme)`` and ``check_solver(function)`` are the tests of this package's own schemes and solvers. They
need no pytest: each returns a table of laws, or raises an AssertionError with one sentence.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from .integrators import SCHEME, Integrator, integrator
from .measures.amplification import amplification
from .measures.errors import observed_order
from .model.contact import Contact, Stops
from .model.system import System
from .model.time_functions import Harmonic
from .references import reference
from .schemes import RigidScheme, Scheme, takes_stops
from .schemes.scheme import require_scheme
from .trajectory.trajectory import Diverged

if TYPE_CHECKING:
    import pandas

PERIODS = np.logspace(-2, 2, 41)  # dt/T of the amplification
STEPS = (200, 280, 400, 560, 800)
PROBLEMS = ("free-oscillator", "bilinear-gap", "damped-chain")
LONG = 10.0  # a step of more than four periods
SECONDS, METRES = 1e-3, 1e2  # the other units: milliseconds, centimetres
Law = tuple[str, float, float]  # name, measured value, largest that is allowed


def check_scheme(scheme: Scheme) -> pandas.DataFrame:
    """Check a scheme against the laws of every scheme of this package.

    * order: on a damped, driven pair of masses the error falls with the order that the scheme states, to 0.15; of a
      scheme for rigid stops with that order or a higher one.
    * amplification: on the linear oscillator the step amplifies as ``characteristic`` states, to 1e-8.
    * zero data: a system at rest without loads stays at rest.
    * units: in other units of time and length the motion with contact is the same, to 1e-6.
    * energy: with half the step less than 0.7 of the numerical dissipation is left.
    * stiff contact: on a stop of 4e12 times the stiffness of the system, which no step resolves, the motion stays
      within 100 times that with a soft stop. It is not asked of a scheme that is stable for short steps only.

    Parameters
    ----------
    scheme : Scheme

    Returns
    -------
    pandas.DataFrame
        Columns law, measured, allowed.

    Raises
    ------
    AssertionError
        With every law that does not hold, the value and the bound.
    InputError
        For anything but a scheme, and for a step that is not linear, pure and causal.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> from stiffbeam.testing import check_scheme
    >>> list(check_scheme(sb.BDF2()).columns)
    ['law', 'measured', 'allowed']
    """
    require_scheme(scheme)
    one = integrator(scheme)
    rigid = isinstance(scheme, RigidScheme)
    pair = _pair(coupled=not rigid)
    exact = reference(pair, 4.0)
    ends = np.concatenate([x[-1] for x in exact.states])
    runs = [one.run(pair, 4.0 / n, 4.0) for n in STEPS]
    errors = [float(np.max(np.abs(np.concatenate([x[-1] for x in run.states]) - ends))) for run in runs]
    slope = observed_order([4.0 / n for n in STEPS], errors).slope if min(errors) > 1e-12 else scheme.order
    laws: list[Law] = [("order", scheme.order - slope if rigid else abs(slope - scheme.order), 0.15)]
    if scheme.characteristic(1.0, 0.0) is not None:
        measured, stated = (amplification(scheme, PERIODS, source=s) for s in ("kernel", "closed form"))
        off = np.max(np.abs(measured.spectral_radius - stated.spectral_radius))
        late = (measured.period_elongation - stated.period_elongation) / (1.0 + np.abs(stated.period_elongation))
        laws.append(("amplification", float(np.nanmax([off, *np.abs(late)])), 1e-8))
    lost = [abs(run.energy.lost_fraction()) for run in runs[::2]]
    laws.append(("energy", lost[2] / lost[1] if lost[1] > 1e-12 else 0.0, 0.7))
    law: dict[str, Any] = {"stiffness": np.inf, "restitution": 0.5} if rigid else {"stiffness": 400.0}
    if rigid and not takes_stops(scheme, [Stops(upper=1.0, **law)]):
        law = {"stiffness": np.inf}
    return _table(str(scheme), laws + _of_every_integrator(one, law))


def check_solver(function: Callable[..., Any] | str) -> pandas.DataFrame:
    """Check a function solve(system, dt, t_end), or a reference solver, against the laws of every solver.

    * known answers: errors on three problems of the test set fall as ``score`` expects.
    * zero data, units, stiff contact: as for a scheme, see ``check_scheme``.

    Parameters
    ----------
    function : callable or str
        Returns (t, u) or (t, u, v), see ``score``; or the name of a reference solver.

    Returns
    -------
    pandas.DataFrame
        Columns law, measured, allowed.

    Raises
    ------
    AssertionError
        With every law that does not hold, the value and the bound.

    Examples
    --------
    >>> from stiffbeam.testing import check_solver
    >>> check_solver("dop853")["law"].to_list()
    ['known answers', 'zero data', 'units', 'stiff contact']
    """
    from .testset.score import score

    one = integrator(function)
    card = score(one, PROBLEMS)
    for entry in card.flagged:
        raise AssertionError(f"{one.label}: known answers: {entry.problem.name}: {entry.outcome}, {entry.reason}")
    return _table(
        one.label, [("known answers", float(len(card.flagged)), 0.0), *_of_every_integrator(one, {"stiffness": 400.0})]
    )


def _of_every_integrator(one: Integrator, law: dict[str, Any]) -> list[Law]:
    """Zero data, units and stiff contact."""
    still = one.run(_pair(load=0.0, speed=0.0, coupled=False), 0.01, 1.0).tip
    # Powers of two as units would leave every bit the same.
    ours, theirs = one.run(_mass(law), 1e-3, 1.0), one.run(_mass(law, SECONDS, METRES), 1e-3 / SECONDS, 1.0 / SECONDS)
    same = len(ours.tip) == len(theirs.tip)
    off = np.max(np.abs(theirs.tip / METRES - ours.tip)) / np.max(np.abs(ours.tip)) if same else np.inf
    laws: list[Law] = [("zero data", float(np.max(np.abs(still))), 0.0), ("units", float(off), 1e-6)]
    # No method that is stable for short steps only takes a stop of any stiffness.
    if one.kind == SCHEME:
        short = not isinstance(one.source, RigidScheme) and 0.0 < amplification(one.source, PERIODS).stable_to < np.inf
    else:
        short = _largest(one, _pair(load=0.0, coupled=False), LONG, 100.0 * LONG) > 100.0
    if short:
        return laws
    stiff = _largest(one, _mass({**law, "stiffness": 1e11 * law["stiffness"]}), 0.01, 1.0)
    return [*laws, ("stiff contact", stiff / float(np.max(np.abs(ours.tip))), 100.0)]


def _largest(one: Integrator, system: System, dt: float, t_end: float) -> float:
    """Largest displacement of a run, inf for one that overflows."""
    try:
        return float(np.max(np.abs(one.run(system, dt, t_end).tip)))
    except Diverged:
        return float("inf")


def _pair(load: float = 1.0, speed: float = 0.4, coupled: bool = True) -> System:
    """Two driven masses without stops, with damping that couples their modes or is a multiple of the stiffness."""
    stiffness = np.array([[9.0, -4.0], [-4.0, 6.0]])
    return System.from_matrices(
        [[2.0, 0.1], [0.1, 1.0]], stiffness, [[0.3, -0.2], [-0.2, 0.4]] if coupled else 0.05 * stiffness,
        loads=[([0.0, 1.0], Harmonic(load, 1.3, 0.4))], observe=[0.0, 1.0], initial_velocity=[0.5 * speed, -speed],
    )  # fmt: skip


def _mass(law: dict[str, Any], seconds: float = 1.0, metres: float = 1.0) -> System:
    """A mass on a spring, thrown against a stop, in units of ``seconds`` seconds and 1/``metres`` metres."""
    stop = Stops(upper=0.05 * metres, **law | {"stiffness": law["stiffness"] * seconds**2})
    return System.from_matrices(
        [[1.0]], [[10.0 * seconds**2]], contacts=[Contact(np.ones(1), stop)],
        loads=[([1.0], Harmonic(metres * seconds**2, 3.0 * seconds, 0.2))], initial_velocity=[metres * seconds],
    )  # fmt: skip


def _table(name: str, laws: list[Law]) -> pandas.DataFrame:
    """The laws as a table. Raises AssertionError with all that do not hold."""
    import pandas

    broken = [
        f"{law} {measured:.3g}, allowed {allowed:g}" for law, measured, allowed in laws if not measured <= allowed
    ]
    if broken:
        raise AssertionError(f"{name}: {'; '.join(broken)}")
    return pandas.DataFrame(laws, columns=["law", "measured", "allowed"])
