"""Trajectory: what every scheme and every solver returns, and the only input of the measures."""

from __future__ import annotations

import pickle
import platform
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from functools import cache, cached_property
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.resources import afford
from ..basics.text import DRAW, printable, several
from ..basics.validation import InputError, integer, numbers, positive, sequence
from .recorder import run_fields, sampled_record
from .records import ContactRecord, Impacts, Ledger, as_it_starts
from .schema import Saved

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..model.contact import Stops
    from ..model.system import System

# A run at every step in pieces that share end points: times (k + 1,), q (k + 1, n), q' (k + 1, n), forces (k + 1, m).
# Forces of rigid stops are the mean reactions of the steps that end there. NaN where no force is known.
Pieces = Callable[[], Iterator[tuple[Array, Array, Array, Array]]]


@cache
def versions() -> dict[str, str]:
    """Versions of the programs that made a run, for its provenance."""
    return {"stiffbeam": version("stiffbeam"), "numpy": np.__version__, "python": platform.python_version()}


class _Stopped(RuntimeError):
    """A run that ended at the time t, by its method, that time, and further parts of a sentence."""

    verb: ClassVar[str]

    def __init__(self, method: str, t: float, *others: str) -> None:
        super().__init__(method, t, *others)
        self.t = t

    def __str__(self) -> str:
        method, t, *others = self.args
        return printable(f"{method} {self.verb} at t = {t:.6g}: {'; '.join(others)}")


class Diverged(_Stopped):
    """A run of a scheme that overflowed. The message gives a fix.

    Attributes
    ----------
    t : float
        Time of the first value that is not finite.
    """

    verb = "overflowed"


class SolverFailure(_Stopped):
    """A reference solver that could not go on. The message gives the reason and a fix.

    Attributes
    ----------
    t : float
        The time that the solver had reached.
    """

    verb = "stopped"


@dataclass(frozen=True)
class Work:
    """Cost of a run. steps: of a scheme, 0 for a reference. seconds: processor time without compilation, wall time for
    ensembles. march_seconds: the stepping alone. counters: of a reference, "rhs", "jacobians" and "restarts" of
    adaptive solvers; with SUNDIALS also "steps", "error_test_failures" and "convergence_failures"."""

    steps: int = 0
    seconds: float = 0.0
    march_seconds: float = 0.0
    counters: dict[str, int] = field(default_factory=dict)

    @property
    def ns_per_step(self) -> float:
        """Nanoseconds per step of the march, without the setup; NaN without steps."""
        return 1e9 * self.march_seconds / self.steps if self.steps else float("nan")


@dataclass(frozen=True, eq=False, kw_only=True)
class Trajectory(Saved):
    """A run or reference at its output times t (k,): tip and tip_velocity (k,), contacts, work, provenance.

    ``integrate``, ``reference`` and ``load`` return it; ``from_arrays`` makes one of a run by another program.
    ``energy`` and ``states`` are computed on first use. Those of a scheme come from a second run, equal to rounding. A
    loaded file has those that were saved.

    Parameters
    ----------
    t, tip, tip_velocity : array (k,)
    contacts : sequence of ContactRecord
        Position, velocity, force and impacts of every contact.
    work : Work
        Steps, seconds and counters.
    provenance : dict
        Scheme, step, versions and what else repeats the run.
    system : System, optional

    Examples
    --------
    >>> import stiffbeam as sb
    >>> run = sb.integrate(sb.paper_case(10).system(), sb.HHT(alpha=-0.1), dt=1e-4, t_end=0.1)
    >>> run.t.shape, run.tip.shape, run.contact_force.shape
    ((1001,), (1001,), (1001,))
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
    diverged: float = field(default=float("nan"), repr=False)  # when it overflowed; ``integrate`` raises then
    stored_fingerprint: str = field(default="", repr=False)  # the fingerprint of a system that is not at hand

    @classmethod
    def from_arrays(
        cls,
        t: ArrayLike,
        tip: ArrayLike,
        tip_velocity: ArrayLike | None = None,
        system: System | None = None,
        name: str = "own",
    ) -> Trajectory:
        """A run of another program: positions of the tip, and its velocity, at increasing times t (k,) from 0 on.

        With a system, tip and tip_velocity may be q and q' (k, n) of all unknowns, which also give the energy balance,
        every contact and the displacement. If a time occurs twice, or increases by rounding only, as at an event, the
        later row counts, and ``t`` has it once.

        tip_velocity: by default that of a cubic spline through the tip, which smooths every kink; the provenance then
        states this. system: what was integrated; with it the run can be compared, and the contact at the tip has its
        sampled impacts and force. Quantities that the arrays do not determine are NaN, or raise an error when used.
        name: its name in tables and pictures. provenance["dt"] is the median step. Raises InputError for decreasing
        times, two positions at one time, other shapes, and numbers that are not finite.
        """
        entries = run_fields(t, tip, tip_velocity, system, name)
        unknown = float("nan")
        return cls(work=Work(len(entries["t"]) - 1, unknown, unknown), **entries)

    def __getstate__(self) -> dict[str, Any]:
        """The state that can be sent to another process: in place of a solver's functions their outputs."""
        state, sources = dict(vars(self)), {"ledger": "energy", "pieces": "states", "state_at": "states"}
        for name in sources.keys() | state.keys() & {"evaluate", "derive", "solution"}:
            try:
                pickle.dumps(state.get(name))
            except Exception:  # whatever the objects of others raise when they are pickled
                state[name] = None
                if name in sources:
                    state[sources[name]] = getattr(self, sources[name])
        return state

    def __repr__(self) -> str:
        end = f"{self.t[-1]:g}"
        impacts = several(sum(c.impacts.count for c in self.contacts), "impact")
        impacts += f" at {len(self.contacts)} contacts" if len(self.contacts) > 1 else ""
        return f"<{type(self).__name__} {self.label}: {len(self.t)} times to {end}, {impacts}>"

    @property
    def stops(self) -> list[Stops]:
        """The stops of every contact."""
        return [contact.stops for contact in self.contacts]

    @property
    def contact_force(self) -> Array:
        """sigma on the beam at the first contact (2.4), zero without contact; ``contacts[i].force`` has every one."""
        return self.contacts[0].force if self.contacts else np.zeros_like(self.t)

    @property
    def impacts(self) -> Impacts:
        """The impacts at the first contact; ``contacts[i].impacts`` has those of every one."""
        return self.contacts[0].impacts if self.contacts else Impacts.at([], [], "none")

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the system, see ``System.fingerprint``; empty for arrays without a system."""
        return self.stored_fingerprint if self.system is None else self.system.fingerprint

    @cached_property
    def states(self) -> tuple[Array, Array]:
        """(q, q') at the output times, each (k, n); q is v = u - phi (1 - (x/L)^2) for a beam."""
        if self.pieces is None:
            raise InputError("states", self._source, "come from a run", "integrate again, or pass q and v")
        every, kept, first = int(self.provenance.get("every", 1)), [], 0
        for t, q, v, _ in self.pieces():
            # Pieces share end points: the first row of a later one is there already.
            begin = first + 1 if first else 0
            rows = slice(-(-begin // every) * every - first, None, every)
            kept.append((q[rows], v[rows]))
            first += len(t) - 1
        q, v = (np.concatenate(x) for x in zip(*kept, strict=True))
        return q, v

    @property
    def _source(self) -> str:
        """Source of a run that lacks states or reactions."""
        return "arrays" if self.provenance.get("source") == "arrays" else "a loaded file"

    @property
    def has_energy(self) -> bool:
        """True if the run has an energy balance, or can compute one."""
        return self.ledger is not None or "energy" in vars(self)

    @cached_property
    def energy(self) -> Ledger:
        """Energy balance at the output times; that of a scheme is summed over every step. Raises Diverged if an energy
        is beyond float64 although the motion is not."""
        if self.ledger is None:
            rule = "come from a run with states and the reactions of rigid stops"
            raise InputError("energy", self._source, rule, "integrate again, or pass q and v")
        ledger = self.ledger()
        finite = np.all([np.isfinite(getattr(ledger, column.name)) for column in fields(ledger)], axis=0)
        if not np.all(finite):
            remedy = "an energy is beyond float64; count in other units"
            raise Diverged(str(self.provenance["method"]), float(ledger.t[np.argmin(finite)]), remedy)
        return ledger

    def displacement(self, x: ArrayLike) -> Array:
        """u(x, t) at the output times; x (...) in [0, L] gives (k, ...)."""
        return self._beam.displacement(self.t, self.states[0], x)

    def velocity(self, x: ArrayLike) -> Array:
        """u_t(x, t) at the output times, as ``displacement``."""
        return self._beam.displacement(self.t, self.states[1], x, of="rate")

    @property
    def _beam(self) -> System:
        if self.system is None:
            raise InputError("displacement(x)", "a loaded file", "be asked of a run", "integrate again")
        return self.system

    def plot(self) -> Figure:
        """Draw displacement, contact forces, phase portrait and energy, and return the matplotlib Figure."""
        return DRAW["run"](self)

    def animate(self, file: str | Path, beside: Sequence[Trajectory] = (), frames: int = 160) -> Path:
        """Write a film, .gif or .mp4 with 20 ``frames`` per second, of this run and runs ``beside`` it."""
        return DRAW["film"]([self, *sequence("beside", beside, "be runs")], file, frames)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Reference(Trajectory):
    """A Trajectory with the time to which it is reliable, and, of some solvers, values between its outputs.

    Parameters
    ----------
    horizon : float
        The time to which an independent or more precise solution agrees with it: |du| <= 1e-3 max|u| for the tip and
        for every contact, and impact times to a thousandth of the longest natural period and to a twentieth of the mean
        time between them. NaN where nothing has been compared. ``provenance["horizon_against"]`` names the other
        solution; ``print(reference)`` states all this.

    Examples
    --------
    >>> import numpy as np
    >>> import stiffbeam as sb
    >>> reference = sb.reference(sb.paper_case(10).system(), t_end=0.2)
    >>> reference.horizon
    0.2
    >>> tip, velocity = reference.at(np.array([0.05, 0.1]))
    >>> tip.shape
    (2,)
    """

    horizon: float = float("nan")
    evaluate: Callable[[Array, int], tuple[Array, Array]] | None = field(default=None, repr=False)  # (t, channel)
    state_at: Callable[[Array], tuple[Array, Array]] | None = field(default=None, repr=False)
    solution: Any = field(default=None, repr=False)  # the solver's own representation, where it has one
    derive: Callable[[Reference, Sequence[Any], Array], Any] | None = field(
        default=None, repr=False
    )  # see ``derivative``

    kind = "reference"

    def __str__(self) -> str:
        """The repr, and under it the error statement: to which time, how exactly, and what it was compared with."""
        against, within = (str(self.provenance.get(f"horizon_{name}", "")) for name in ("against", "tolerance"))
        if not (np.isfinite(self.horizon) and against):
            return f"{self!r}\nIts error is not known: it was compared with nothing."

        other = "the exact solution" if against == "exact" else against
        end = f"{self.horizon:.4g}"
        return f"{self!r}\nValid to t = {end}: {within or 'to 0.001 of max|u|'}. Compared with {other}."

    def __repr__(self) -> str:
        trust = f"; valid to its horizon {self.horizon:.4g}, one realisation past it"
        return f"{super().__repr__()[:-1]}{trust if self.horizon < self.t[-1] else ''}>"

    def at(self, t: ArrayLike, contact: int | None = None) -> tuple[Array, Array]:
        """(tip, tip velocity) at any times in [0, t_end], or position and velocity of a contact."""
        t = self._times(t)
        if contact is not None and integer("contact", contact, 0) >= len(self.contacts):
            remedy = f"0 to {len(self.contacts) - 1}" if self.contacts else "leave it out for the tip"
            raise InputError("contact", contact, "be the number of a contact", remedy)
        if self.evaluate is None:  # a copy from another process has its outputs
            index = np.clip(np.searchsorted(self.t, t - 1e-12 * self.t[-1]), 0, len(self.t) - 1)
            if np.any(np.abs(self.t[index] - t) > 1e-11 * self.t[-1]):
                remedy = "for a comparison pass t_eval=run.t, or numpy.unique(t) for arrays (t, tip)"
                raise InputError("t", "new times", f"be among t_eval for {self.provenance['method']}", remedy)
            if contact is None:
                return self.tip[index], self.tip_velocity[index]
            return self.contacts[contact].position[index], self.contacts[contact].velocity[index]
        tip = self.system.tip_channel if self.system else len(self.contacts)
        channel = tip if contact is None else contact
        seen = self.evaluate(t, channel)
        return seen if self.system is None else as_it_starts(self.system, channel, t, *seen)

    def derivative(self, wrt: Sequence[Any], t: ArrayLike | None = None) -> Any:
        """Return the derivatives of an exact solution in parameters and initial data, all in one pass.

        Parameters
        ----------
        wrt : sequence of str or pairs
            Paths as ``varied_members`` takes them: "stops[0].stiffness", "stops.upper", "loads[0].time.amplitude",
            "viscosity", "q0[2]", "v0[0]"; "initial_displacement" and "initial_velocity" are all their n entries.
            A pair ("stiffness", dK) is the derivative along the matrix dK (n, n), of "mass" and "damping" likewise.
        t : (k,) array, optional
            Increasing times in [0, t_end]; the output times by default.

        Returns
        -------
        Derivative
            ``tip`` and ``tip_velocity`` (k, p), ``state`` (k, 2n, p). Where a derivative ceases to exist,
            ``exists_until`` and ``reason`` say when and why, and later entries are NaN. ``horizon`` is the time to
            which rounding leaves the derivatives three digits.

        Raises
        ------
        InputError
            For a reference that is not exact, and for paths that lead to no number of the system.

        Examples
        --------
        >>> import stiffbeam as sb
        >>> ball = sb.System.from_matrices(
        ...     [[1.0]], [[0.0]], loads=[([1.0], sb.Constant(-9.81))], initial_displacement=[1.0],
        ...     contacts=[sb.Contact([1.0], sb.Stops(lower=0.0, stiffness=float("inf"), restitution=0.8))])
        >>> change = sb.reference(ball, 0.6).derivative(["q0[0]"])
        >>> round(float(change.tip[600, 0]), 6)  # before the first impact
        1.0
        """
        if self.derive is None:
            rule = 'be of method "exact" and solved in this process for a derivative'
            remedy = "solve it here: sb.reference(system, t_end); without an exact solution take differences of two"
            raise InputError("reference", self.provenance["method"], rule, remedy)
        paths = (wrt,) if isinstance(wrt, str) else tuple(sequence("wrt", wrt, "name parameters"))
        if not paths or not all(isinstance(x, str) or (isinstance(x, tuple) and len(x) == 2) for x in paths):
            raise InputError("wrt", wrt, "name parameters", 'for example ["stops[0].stiffness"]')
        times = self._times(self.t if t is None else t)
        if np.any(np.diff(times) <= 0.0):
            raise InputError("t", t, "increase", "sort the times")
        return self.derive(self, paths, times)

    def _times(self, t: ArrayLike) -> Array:
        """Times in [0, t_end] as an array; beyond t_end by rounding is t_end."""
        times, end = np.atleast_1d(numbers("t", t)), float(self.provenance["t_end"])
        if times.ndim != 1 or not times.size:
            raise InputError("t", t, "be one time or some in a row", "ravel it")
        if np.any((times < 0.0) | (times > end * (1 + 1e-12))):
            raise InputError("t", (times.min(), times.max()), f"lie in [0, {end:g}]", "solve for a longer t_end")
        return np.minimum(times, end)

    def impacts_sampled(self, dt: float, t_end: float | None = None, contact: int = 0) -> Impacts:
        """The impacts that a perfect scheme with step ``dt`` would count at a contact: those of the exact u(n dt)."""
        positive("dt", dt)
        end = float(self.provenance["t_end"]) if t_end is None else positive("t_end", t_end)
        size = 3.0 if self.system is None else 2.0 * self.system.size
        afford("dt", dt, "give a larger dt", floats=size * end / dt)
        steps = int(np.floor(end / dt * (1 + 1e-12)))
        t = np.arange(steps + 1) * dt
        return sampled_record(t, *self.at(t, contact=contact), self.contacts[contact].stops).impacts

    @cached_property
    def states(self) -> tuple[Array, Array]:
        """(q, v) at the times t, one row a time; InputError where the solution was loaded without its system."""
        if self.state_at is None:
            remedy = "an exact one has them with its system: sb.load(file, system)"
            raise InputError("states", "a loaded file", "come from a run", remedy)
        return self.state_at(self.t)
