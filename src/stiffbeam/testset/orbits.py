"""Periodic orbits with proved enclosures, as known answers for shooting and harmonic-balance codes."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..basics.arrays import Array
from ..basics.validation import InputError, near, numbers
from ..model.system import System
from .problem import folder, system_of

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
        return f"<FrozenOrbit {self.name}: {self.title}; {kind}, {len(self.itinerary)} events>"

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
            Of these the largest is compared.

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


@cache
def _all() -> dict[str, FrozenOrbit]:
    files = sorted(folder("orbits").glob("*.toml"))
    return {orbit.name: orbit for orbit in (read_orbit(file.read_text(encoding="utf-8")) for file in files)}


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
    return dict(_all())


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
    <FrozenOrbit impact-oscillator: One mass and a rigid stop; unstable, 1 events>
    """
    if name not in _all():
        raise InputError("orbit", name, "be one of the frozen orbits", near(name, _all()))
    return _all()[name]
