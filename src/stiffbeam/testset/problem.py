"""Problems of the test set and periodic orbits: systems as plain numbers, with answers that are known or enclosed."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..basics.arrays import Array
from ..basics.text import several
from ..basics.validation import InputError, numbers, one_of
from ..files.reader import SystemReader
from ..model.sampled import Sampled
from ..model.system import System
from ..model.time_functions import LoadFunction, TimeFunction

# Of the test set: the first number changes when an answer does, the second when problems or answers are added.
VERSION = "3.3"


@dataclass(frozen=True)
class Answer:
    """A known number, or several: ``digits`` as decimals in text, and ``how``, the method that gave them."""

    digits: str | tuple[str, ...]
    how: str

    @property
    def value(self) -> Any:
        """The nearest double, or doubles as an array."""
        return float(self.digits) if isinstance(self.digits, str) else np.array([float(x) for x in self.digits])


@dataclass(frozen=True)
class Statistics:
    """Statistics past the horizon, where no single motion is known: mean and standard deviation of each quantity over
    ``members`` exact motions to ``t_end`` whose initial data differ by ``size``. steps: the numbers of steps of a
    score.
    """

    t_end: float
    members: int
    size: float
    seed: int
    steps: tuple[int, ...]
    how: str
    values: Mapping[str, tuple[float, float]]


@dataclass(frozen=True, eq=False)
class Problem:
    """One problem of the test set with its known answers.

    Its numbers are the doubles that a TOML reader returns, and the answers hold for these doubles.

    Parameters
    ----------
    number : int
    name, title, source : str
    catches : str
        Mistakes of an integrator that the problem finds.
    t_end : float
    samples : int
        ``tip`` and ``tip_velocity`` are known at the times k t_end/samples, k = 1, 2, ...
    steps : sequence of int
        Numbers of steps of the fixed-step runs, each a multiple of ``samples``.
    order_limit : float
        Highest order of fixed-step schemes that do not locate events, given the law: 2 for a kink of the force, 1 for a
        jump of force or velocity.
    answers : mapping of str to Answer
        A score measures ``tip`` and ``tip_velocity``; ``impacts`` and ``releases``, the times of entry into the stops
        of the first contact and of exit; ``peak_force``; and ``energy`` at t_end, against ``energy_scale``.
    data : mapping
        The [system] of the file.
    statistics : Statistics, optional
        Values past the horizon.
    derivatives : mapping of str to mapping of str to Answer
        Of ``tip`` and ``tip_velocity`` at t_end, by the path of a parameter: ``derivatives["tip"]["q0[0]"]``. Empty
        where none are known.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sorted(sb.problem("bouncing-ball").answers)[:2]
    ['accumulation', 'energy']
    """

    number: int
    name: str
    title: str
    source: str
    catches: str
    t_end: float
    samples: int
    steps: tuple[int, ...]
    order_limit: float
    answers: Mapping[str, Answer]
    data: Mapping[str, Any]
    statistics: Statistics | None = None
    derivatives: Mapping[str, Mapping[str, Answer]] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<Problem {self.name}: {self.title}>"

    @property
    def times(self) -> Array:
        """Times (samples,) of tip and tip_velocity."""
        return np.arange(1, self.samples + 1) * self.t_end / self.samples

    @property
    def rigid(self) -> bool:
        """True if a stop is rigid, with a restitution."""
        return self.system.rigid

    @cached_property
    def system(self) -> System:
        """The system to integrate."""
        return system_of(self.name, self.data)


class _SystemReader(SystemReader):
    """Reads the [system] of a problem: bands of matrices, loads by their vector, samples by their times."""

    def matrix(self, field: str) -> Array:
        """A matrix, see ``matrix``."""
        return matrix(self.table[field])

    def load(self, n: int) -> tuple[Array, LoadFunction]:
        """(vector, time function) of one load on n unknowns."""
        return self.row("vector", n), self.time_function({"vector"})

    def time_function(self, besides: set[str]) -> TimeFunction:
        """amplitude sin(frequency t + phase), a constant, or values at times with straight lines between them."""
        if "times" not in self.table:
            return super().time_function(besides)
        self.only({"times", "values", "kind"} | besides)
        return self.build(Sampled, self.table["times"], self.table["values"], kind=self.table.get("kind", "linear"))


def system_of(name: str, data: Mapping[str, Any]) -> System:
    """A System from the [system] of a file; ``name`` is for messages."""
    return _SystemReader(dict(data), f"{name}: system").system()


def matrix(given: ArrayLike | Mapping[str, Any]) -> Array:
    """A symmetric matrix from its rows, or from { bands = [[a_11, a_22, ...], [a_12, a_23, ...], ...] }."""
    if not isinstance(given, Mapping):
        return np.array(given, float)
    bands = [np.array(band, float) for band in given["bands"]]
    full = np.diag(bands[0])
    for k, band in enumerate(bands[1:], start=1):
        full = full + np.diag(band, k) + np.diag(band, -k)
    return full


def folder(kind: str = "problems") -> Path:
    """Folder of the problems or "orbits": inside an installed package, or in reference/ of a source tree."""
    packaged = Path(__file__).parents[1] / "frozen" / kind
    return packaged if packaged.is_dir() else Path(__file__).parents[3] / "reference" / kind


def read(text: str) -> Problem:
    """A problem from the text of its file."""
    table = tomllib.loads(text)
    answers = {
        name: Answer(tuple(x["value"]) if isinstance(x["value"], list) else x["value"], x["how"])
        for name, x in table["answers"].items()
    }
    known, statistics = table.get("statistics"), None
    if known is not None:
        values = {name: (x["mean"], x["deviation"]) for name, x in known.pop("values").items()}
        statistics = Statistics(**known | {"steps": tuple(known["steps"])}, values=values)
    derivatives = table.get("derivatives", {})
    how = derivatives.pop("how", "")
    known_derivatives = {
        what: {path: Answer(digits, how) for path, digits in values.items()} for what, values in derivatives.items()
    }
    plain = ("number", "name", "title", "source", "catches", "t_end", "samples", "order_limit")
    given = {key: table[key] for key in plain}
    return Problem(**given, steps=tuple(table["steps"]), answers=answers, data=table["system"], statistics=statistics,
                   derivatives=known_derivatives)  # fmt: skip


@cache
def _all(kind: str) -> dict[str, Any]:
    """The files of a folder as problems or orbits, by name."""
    reader = read if kind == "problems" else read_orbit
    made = [reader(file.read_text(encoding="utf-8")) for file in sorted(folder(kind).glob("*.toml"))]
    return {one.name: one for one in sorted(made, key=lambda one: getattr(one, "number", 0))}


def _named(kind: str, name: str) -> Any:
    """The problem or orbit ``name``. Raises InputError for any other name."""
    what, whole = ("problem", "test set") if kind == "problems" else ("orbit", "frozen orbits")
    return _all(kind)[one_of(what, name, _all(kind), f"be one of the {whole}")]


def problems() -> dict[str, Problem]:
    """Return the test set: vibro-impact problems with known answers, by name.

    Returns
    -------
    dict of str to Problem

    Examples
    --------
    >>> import stiffbeam as sb
    >>> list(sb.problems())[:2]
    ['free-oscillator', 'bilinear-oscillator']
    """
    return dict(_all("problems"))


def problem(name: str) -> Problem:
    """Return one problem of the test set.

    Parameters
    ----------
    name : str
        As ``problems()`` lists it.

    Returns
    -------
    Problem

    Raises
    ------
    InputError
        For an unknown name.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.problem("bouncing-ball").system
    <System, matrices: 1 unknown, 1 load, 1 contact>
    """
    return _named("problems", name)


CLOSE = 1e-12  # of the period: times of samples that leave it by less


@dataclass(frozen=True)
class EnclosedAnswer:
    """Decimals of numbers, each at most ``radius`` away from the true one.

    Parameters
    ----------
    digits : nested tuple of str
    radius : str
        A proved bound, as a decimal.
    """

    digits: Any
    radius: str

    @property
    def value(self) -> Array:
        """The nearest doubles."""
        return np.array(self.digits, float)


@dataclass(frozen=True, eq=False)
class FrozenOrbit:
    """A periodic orbit that ``Orbit.prove`` has proved; its numbers are the doubles that a TOML reader gives.

    Parameters
    ----------
    name, title : str
    period : float
        The double nearest to the exact period, ``period_text``.
    period_text : str
        The exact period, for example "2 pi/33.0".
    stable : bool
    itinerary : tuple of (contact, from side, to side)
        The events in order; an impact on a rigid stop is (contact, 0, 0).
    answers : mapping of str to EnclosedAnswer
        ``event_times`` (k,); ``q`` and ``v``, states (samples, n) at the times k period/samples; and the
        ``multipliers_real`` and ``multipliers_imag`` (2n,), the largest first.
    bits : int
        Precision of the proof.
    data : mapping
        The [system] of the file.

    Examples
    --------
    >>> import numpy as np, stiffbeam as sb
    >>> orbit = sb.frozen_orbit("bilinear-unstable")
    >>> orbit.stable, round(float(orbit.multipliers[0].real), 6)
    (False, 1.417422)
    >>> run = sb.reference(orbit.system, orbit.period, t_eval=orbit.times)
    >>> orbit.score(run.t, run.states[0])["q"] < 1e-10
    True
    """

    name: str
    title: str
    period: float
    period_text: str
    stable: bool
    itinerary: tuple[tuple[int, int, int], ...]
    answers: Mapping[str, EnclosedAnswer]
    bits: int
    data: Mapping[str, Any] = field(repr=False)

    def __repr__(self) -> str:
        kind = "stable" if self.stable else "unstable"
        return f"<FrozenOrbit {self.name}: {self.title}; {kind}, {several(len(self.itinerary), 'event')}>"

    @cached_property
    def system(self) -> System:
        """The system, which starts on the orbit."""
        start = {"initial_displacement": self.q[0].tolist(), "initial_velocity": self.v[0].tolist()}
        return system_of(self.name, {**self.data, **start})

    @property
    def q(self) -> Array:
        """Displacements (samples, n) at ``times``."""
        return self.answers["q"].value

    @property
    def v(self) -> Array:
        """Velocities (samples, n) at ``times``."""
        return self.answers["v"].value

    @property
    def times(self) -> Array:
        """Times k period/samples of ``q`` and ``v``."""
        return np.arange(len(self.q)) * self.period / len(self.q)

    @property
    def event_times(self) -> Array:
        """In (0, period), (k,)."""
        return self.answers["event_times"].value

    @property
    def multipliers(self) -> NDArray[np.complex128]:
        """Floquet multipliers (2n,), the largest first."""
        return self.answers["multipliers_real"].value + 1j * self.answers["multipliers_imag"].value

    def score(
        self, t: ArrayLike, q: ArrayLike, v: ArrayLike | None = None, multipliers: ArrayLike | None = None
    ) -> dict[str, float]:
        """Errors of an orbit computed by other means.

        Parameters
        ----------
        t : array_like (k,)
            Times in [0, period], on the clock of the loads.
        q, v : array_like (k, n)
            Displacements, and velocities where they are known.
        multipliers : array_like, optional
            Floquet multipliers, of which the largest is compared.

        Returns
        -------
        dict of str to float
            ``q`` and ``v``: largest error over the largest value on the orbit. ``q_rms``: root mean square of the error
            over that of the orbit. ``multiplier``: relative error of the modulus of the largest one.

        Raises
        ------
        InputError
            For times outside the period, and for arrays of another shape.
        """
        from ..references import reference

        n, when = self.system.size, np.atleast_1d(numbers("t", t))
        if np.any(when < -CLOSE * self.period) or np.any(when > (1.0 + CLOSE) * self.period):
            raise InputError("t", t, f"be in [0, {self.period!r}]", "take the times modulo the period")
        # The reference takes increasing times with both ends; ``place`` leads back to the times asked for.
        order = np.argsort(when, kind="stable")
        asked = np.clip(when[order], 0.0, self.period)
        exact = reference(self.system, self.period, t_eval=np.unique(np.concatenate([[0.0], asked, [self.period]])))
        place = np.searchsorted(exact.t, asked)
        errors = {}
        for key, values, truth in (("q", q, exact.states[0]), ("v", v, exact.states[1])):
            if values is None:
                continue
            array = numbers(key, values)
            if array.ndim == 1 and n == 1:
                array = array[:, None]
            if array.shape != (len(when), n):
                raise InputError(key, array.shape, f"have the shape {(len(when), n)}", "one row for each time")
            away = array[order] - truth[place]
            errors[key] = float(np.max(np.abs(away)) / np.max(np.abs(truth)))
            if key == "q":
                errors["q_rms"] = float(np.sqrt(np.mean(away**2) / np.mean(truth**2)))
        if multipliers is not None:
            largest = float(np.max(np.abs(np.atleast_1d(np.asarray(multipliers, complex)))))
            errors["multiplier"] = abs(largest / abs(self.multipliers[0]) - 1.0)
        return errors


def read_orbit(text: str) -> FrozenOrbit:
    """A frozen orbit from the text of its file."""
    table = tomllib.loads(text)
    plain = {key: table[key] for key in ("name", "title", "period_text", "stable", "bits")}
    answers = {key: EnclosedAnswer(_tuples(x["value"]), x["radius"]) for key, x in table["answers"].items()}
    itinerary = tuple((int(c), int(old), int(new)) for c, old, new in table["itinerary"])
    return FrozenOrbit(
        **plain, period=float(table["period"]), itinerary=itinerary, answers=answers, data=table["system"]
    )


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def frozen_orbits() -> dict[str, FrozenOrbit]:
    """Return the periodic orbits with proved enclosures, by name.

    Returns
    -------
    dict of str to FrozenOrbit

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sum(not orbit.stable for orbit in sb.frozen_orbits().values()) >= 8
    True
    """
    return dict(_all("orbits"))


def frozen_orbit(name: str) -> FrozenOrbit:
    """Return one periodic orbit with proved enclosures.

    Parameters
    ----------
    name : str
        As ``frozen_orbits()`` lists it.

    Returns
    -------
    FrozenOrbit

    Raises
    ------
    InputError
        For an unknown name.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.frozen_orbit("impact-oscillator")
    <FrozenOrbit impact-oscillator: One mass and a rigid stop; unstable, 1 event>
    """
    return _named("orbits", name)
