"""Problems of the test set: systems as plain numbers, with known answers."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.validation import one_of
from ..files.reader import Reader, located
from ..model.system import System

# Of the test set: the first number changes when an answer does, the second when problems or answers are added.
VERSION = "3.4"


@dataclass(frozen=True)
class Answer:
    """A known number, or several: ``digits`` as decimals in text, and ``how``, the method that gave them."""

    digits: str | tuple[str, ...]
    how: str

    @property
    def value(self) -> Any:
        """The nearest double, or doubles as an array."""
        return float(self.digits) if isinstance(self.digits, str) else np.array([float(x) for x in self.digits])


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
    derivatives: Mapping[str, Mapping[str, Answer]] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<Problem {self.name}: {self.title}>"

    @property
    def times(self) -> Array:
        """Times (samples,) of tip and tip_velocity."""
        return np.arange(1, self.samples + 1) * self.t_end / self.samples

    @cached_property
    def system(self) -> System:
        """The system to integrate."""
        return system_of(self.name, self.data)


def system_of(name: str, data: Mapping[str, Any]) -> System:
    """A System from the [system] of a file; ``name`` is for messages."""
    table = dict(data)
    table |= {x: matrix(table[x]).tolist() for x in ("mass", "stiffness", "damping") if x in table}
    table["loads"] = [_load(load) for load in table.get("loads", [])]
    try:
        return Reader(None).read(table, System)
    except Exception as error:
        raise located(error, f"{name}: system") from None


def _load(table: Mapping[str, Any]) -> dict[str, Any]:
    """A load of a problem as that of a case: its vector is a row, values at times are samples."""
    load = dict(table)
    load["row"] = load.pop("vector")
    if "times" in load:
        load["sampled"] = {"t": load.pop("times"), "values": load.pop("values")}
    return load


def matrix(given: ArrayLike | Mapping[str, Any]) -> Array:
    """A symmetric matrix from its rows, or from { bands = [[a_11, a_22, ...], [a_12, a_23, ...], ...] }."""
    if not isinstance(given, Mapping):
        return np.array(given, float)
    upper: Any = sum(np.diag(np.array(band, float), k) for k, band in enumerate(given["bands"]))
    return upper + np.triu(upper, 1).T


def folder() -> Path:
    """Folder of the problems: inside an installed package, or in reference/ of a source tree."""
    packaged = Path(__file__).parents[1] / "frozen" / "problems"
    return packaged if packaged.is_dir() else Path(__file__).parents[3] / "reference" / "problems"


def read(text: str) -> Problem:
    """A problem from the text of its file."""
    table = tomllib.loads(text)
    data, derivatives = table.pop("system"), table.pop("derivatives", {})
    how = derivatives.pop("how", "")
    for name, answer in table["answers"].items():
        digits = answer["value"]
        table["answers"][name] = Answer(digits if isinstance(digits, str) else tuple(digits), answer["how"])
    table["steps"] = tuple(table["steps"])
    known = {kind: {path: Answer(digits, how) for path, digits in of.items()} for kind, of in derivatives.items()}
    return Problem(**table, data=data, derivatives=known)


@cache
def _all() -> dict[str, Problem]:
    """The test set by name."""
    made = [read(file.read_text(encoding="utf-8")) for file in sorted(folder().glob("*.toml"))]
    return {one.name: one for one in sorted(made, key=lambda one: one.number)}


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
    return dict(_all())


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
    return _all()[one_of("problem", name, _all(), "be one of the test set")]
