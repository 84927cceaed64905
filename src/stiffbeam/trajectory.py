"""Trajectory: what every scheme and every solver returns, and all that the measures see."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache, cached_property
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arrays import Array
from .contact import Stops
from .validation import InputError, positive

if TYPE_CHECKING:
    import xarray

    from .ledger import Ledger
    from .system import System

# Pieces of a run at every step: times (k + 1,), q (k + 1, n), q' (k + 1, n); pieces share end points.
Pieces = Callable[[], Iterator[tuple[Array, Array, Array]]]


@cache
def versions() -> dict[str, str]:
    """What a run was made with, for its provenance."""
    return {"stiffbeam": version("stiffbeam"), "numpy": np.__version__, "python": platform.python_version()}


class Diverged(RuntimeError):
    """A run overflowed: ``scheme`` at time ``t``; ``remedy`` says what to try."""

    def __init__(self, scheme: str, t: float, remedy: str) -> None:
        self.scheme, self.t, self.remedy = scheme, t, remedy
        super().__init__(f"{scheme} overflowed at t = {t:.6g}: {remedy}")


class SolverFailure(RuntimeError):
    """A reference solver gave up: ``solver`` at time ``t``; the message says why and what to try."""

    def __init__(self, solver: str, t: float, reason: str, remedy: str) -> None:
        self.solver, self.t, self.reason, self.remedy = solver, t, reason, remedy
        super().__init__(f"{solver} stopped at t = {t:.6g}: {reason}; {remedy}")


class Unfinished(RuntimeError):
    """Work on several processes or machines stopped half-way; the message says why and how to go on."""


@dataclass(frozen=True, eq=False)
class Impacts:
    """Entries into a stop, in order of time.

    kind "event": t* > 0 where chi goes from 0 to +-1. kind "sampled": steps n >= 1 with chi_n != 0 and
    chi_n != chi_{n-1}; the time is the first crossing of the stop by the cubic Hermite interpolant of
    (u, u'). Contact at t = 0 and touching without penetration do not count.
    times: (count,). stops: (count,), +1 upper, -1 lower. peaks: max |sigma|. impulses: integral of
    |sigma|; both NaN for an impact still open at the end, and where the solver does not measure them.
    """

    times: Array
    stops: NDArray[np.int64]
    peaks: Array
    impulses: Array
    kind: str

    @property
    def count(self) -> int:
        return len(self.times)

    def until(self, t: float) -> Impacts:
        """The impacts at times <= t."""
        keep = self.times <= t
        return Impacts(self.times[keep], self.stops[keep], self.peaks[keep], self.impulses[keep], self.kind)

    @staticmethod
    def none(kind: str) -> Impacts:
        return Impacts(np.zeros(0), np.zeros(0, np.int64), np.zeros(0), np.zeros(0), kind)


@dataclass(frozen=True, eq=False)
class ContactRecord:
    """What happened at one contact: position, velocity and force (sigma on the beam, < 0 on the upper
    stop) at the output times; impacts, share of time in contact, peak |sigma| and impulse over every
    step."""

    stops: Stops
    position: Array
    velocity: Array
    force: Array
    impacts: Impacts
    fraction: float
    peak_force: float
    impulse: float


@dataclass(frozen=True)
class Work:
    """What a run cost. steps: of a fixed-step scheme, 0 for a reference, whose counters tell.

    seconds: all of it but compilation; march_seconds: the stepping alone.
    """

    steps: int = 0
    seconds: float = 0.0
    march_seconds: float = 0.0
    counters: dict[str, int] = field(default_factory=dict)

    @property
    def ns_per_step(self) -> float:
        return 1e9 * self.march_seconds / self.steps if self.steps else float("nan")


@dataclass(frozen=True, eq=False, kw_only=True)
class Trajectory:
    """A run at its output times t (k,): tip and tip_velocity (k,), contacts, work, provenance.

    ``energy`` and ``states`` are made on first use, those of a scheme by going through the run once more,
    equal to rounding, since a run is a function of its arguments; a loaded file has what was saved.
    """

    t: Array
    tip: Array
    tip_velocity: Array
    contacts: tuple[ContactRecord, ...]
    work: Work
    provenance: dict[str, Any]
    system: System | None = field(default=None, repr=False)
    pieces: Pieces | None = field(default=None, repr=False)
    ledger: Callable[[], Ledger] | None = field(default=None, repr=False)  # at the output times
    fingerprint: str = ""

    def __repr__(self) -> str:
        return (
            f"<{type(self).__name__} {self.label}: {len(self.t)} times to {self.t[-1]:g}, {self.impacts.count} impacts>"
        )

    @property
    def label(self) -> str:
        """Method and form, e.g. ``hht(alpha=-0.1)@displacement``."""
        return f"{self.provenance['method']}@{self.provenance['form']}"

    @property
    def contact_force(self) -> Array:
        """sigma on the beam at the first contact (2.4), zero without contact."""
        return self.contacts[0].force if self.contacts else np.zeros_like(self.t)

    @property
    def impacts(self) -> Impacts:
        """The impacts at the first contact."""
        return self.contacts[0].impacts if self.contacts else Impacts.none("none")

    @cached_property
    def states(self) -> tuple[Array, Array]:
        """(q, q') at the output times, each (k, n); q is v = u - phi (1 - x^2) for a beam."""
        if self.pieces is None:
            raise InputError("states", "a loaded file", "come from a run", "integrate again; files keep the tip only")
        wanted = np.round(self.t / self._step).astype(int)
        q, v, first = [], [], 0
        for times, q_piece, v_piece in self.pieces():
            here = wanted[(wanted >= first) & (wanted < first + len(times))] - first
            if first:
                here = here[here > 0]
            q.append(q_piece[here])
            v.append(v_piece[here])
            first += len(times) - 1
        return np.concatenate(q), np.concatenate(v)

    @property
    def _step(self) -> float:
        return float(self.provenance["dt"])

    @cached_property
    def energy(self) -> Ledger:
        """The energy ledger at the output times, of a scheme added up over every step before them."""
        if self.ledger is None:
            raise InputError("energy", "a loaded file", "have been saved with the run", "run it again")
        return self.ledger()

    def displacement(self, x: ArrayLike) -> Array:
        """u(x, t) at the output times; x (...) in [0, 1] gives (k, ...)."""
        if self.system is None:
            raise InputError("displacement(x)", "a loaded file", "be asked of a run", "integrate again")
        return self.system.displacement(self.t, self.states[0], x)

    def save(self, file: str | Path) -> Path:
        """Write a netCDF file that ``stiffbeam.load``, xarray and ncdump read."""
        from .store import save

        return save(self, file)

    def to_xarray(self) -> xarray.Dataset:
        """Tip, contacts, impacts and energy as an xarray.Dataset with units, provenance as attributes."""
        from .store import to_xarray

        return to_xarray(self)


def output_index(t: Array, times: Array, method: str) -> NDArray[np.int64]:
    """Where ``times`` stand among the output times t. Raises InputError for any other time."""
    index = np.clip(np.searchsorted(t, times - 1e-12 * t[-1]), 0, len(t) - 1)
    if np.any(np.abs(t[index] - times) > 1e-11 * t[-1]):
        raise InputError("t", "new times", f"be among t_eval for {method}", "for a comparison pass t_eval=run.t")
    return index


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Reference(Trajectory):
    """A Trajectory that says how far it can be trusted, and where it knows, any time in between.

    horizon: the time to which an independent or more precise solution agrees with it, |du| <= 1e-3
    max|u| and impact times to a thousandth of the longest natural period; NaN where nothing has been
    compared. provenance["horizon_against"] says with what.
    """

    horizon: float = float("nan")
    evaluate: Callable[[Array, int], tuple[Array, Array]] | None = field(default=None, repr=False)  # (t, channel)
    state_at: Callable[[Array], tuple[Array, Array]] | None = field(default=None, repr=False)
    solution: Any = field(default=None, repr=False)  # the solver's own representation, where it has one

    def at(self, t: ArrayLike, contact: int | None = None) -> tuple[Array, Array]:
        """(tip, tip velocity) at any times in [0, t_end], or position and velocity of a contact."""
        t = np.atleast_1d(np.asarray(t, float))
        end = float(self.provenance["t_end"])
        if not np.all(np.isfinite(t)) or np.any((t < 0.0) | (t > end * (1 + 1e-12))):
            raise InputError("t", (t.min(), t.max()), f"lie in [0, {end:g}]")
        if self.evaluate is None:
            method = self.provenance["method"]
            raise InputError("t", "new times", f"be among t_eval for {method}", "for a comparison pass t_eval=run.t")
        tip = self.system.tip_channel if self.system else len(self.contacts)
        channel = tip if contact is None else contact
        return self.evaluate(np.minimum(t, end), channel)

    def impacts_sampled(self, dt: float, t_end: float | None = None) -> Impacts:
        """The impacts a perfect scheme with step ``dt`` would count at the first contact: the sampled
        rule on the exact u(n dt)."""
        from .recorder import sampled_impacts

        end = float(self.provenance["t_end"]) if t_end is None else t_end
        positive("dt", dt)
        steps = int(np.floor(end / dt * (1 + 1e-12)))
        if not self.contacts:
            return Impacts.none("sampled")
        return sampled_impacts(*self.at(np.arange(steps + 1) * dt, contact=0), dt, self.contacts[0].stops)

    @cached_property
    def states(self) -> tuple[Array, Array]:
        if self.state_at is None:
            raise InputError("states", "a loaded file", "come from a run", "solve again; files keep the tip only")
        return self.state_at(self.t)
