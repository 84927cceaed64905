"""The reference solvers, their properties, and what each is asked. A new solver is one file, and one line here.

Everything that lists solvers reads this: ``reference`` and its commands, the cache, studies, pictures, tests.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError, one_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..model.system import System

EXACT, MULTIPRECISION, ADAPTIVE = "exact", "multiprecision", "adaptive"


@dataclass(frozen=True)
class Method:
    """A reference solver.

    name: the name for users. module: in this folder, with ``solve(request) -> Reference``.
    label: its name in pictures, and that of its class in a library of several. look: the number of its dashes and
    marker there, unique and permanent. kind: EXACT (closed form between events, in float64), MULTIPRECISION (the same
    in many digits) or ADAPTIVE (error control: uses rtol, atol and Steps; its impacts are events). packages: on which
    its numbers depend.
    """

    name: str
    module: str
    label: str
    look: int
    kind: str = ADAPTIVE
    packages: tuple[str, ...] = ()

    def versions(self) -> dict[str, str]:
        """The versions of its packages."""
        return {package: version(package) for package in self.packages}


_SCIPY, _SUNDIALS, _DIFFRAX = ("scipy",), ("scikit-sundae",), ("diffrax", "jax")
# Name, module, label and look of each. A new one has the next look: pictures keep theirs.
REFERENCES = {
    method.name: method
    for method in (
        Method("exact", "exact.solution", "exact", 0, EXACT),
        Method("multiprecision", "multiprecision", "multiprecision", 1, MULTIPRECISION, ("python-flint",)),
        Method("cvode", "adaptive.sundials", "CVODE BDF", 2, packages=_SUNDIALS),
        Method("cvode-adams", "adaptive.sundials", "CVODE Adams", 3, packages=_SUNDIALS),
        Method("ida", "adaptive.sundials", "IDA", 4, packages=_SUNDIALS),
        Method("kvaerno3", "adaptive.diffrax", "Kvaerno3", 5, packages=_DIFFRAX),
        Method("kvaerno5", "adaptive.diffrax", "Kvaerno5", 6, packages=_DIFFRAX),
        Method("dop853", "adaptive.scipy", "DOP853", 7, packages=_SCIPY),
        Method("radau", "adaptive.scipy", "Radau", 8, packages=_SCIPY),
        Method("lsoda", "adaptive.scipy", "LSODA", 9, packages=_SCIPY),
    )
}
RTOL = 1e-10  # of an adaptive reference by default
BEST = ("exact", "cvode-adams", "dop853")  # the first that takes a system is the best reference of it
COMPARED = ("exact", "cvode-adams", "cvode", "ida", "kvaerno5")  # references of a comparison by default
BUDGET = 12.0  # CPU seconds that one reference of a comparison may take by default
COMPARED_RIGID = ("exact",)  # on rigid stops, which no other takes


def method_of(name: str, field: str = "method") -> Method:
    """Return the method of this name; for another raise InputError under the name ``field``, with those there are."""
    return REFERENCES[one_of(field, name, REFERENCES, "be a reference method")]


# ---------------------------------------------------------------- what a solver is asked

OUTPUTS = 2001  # times of a solution, where none are asked for


class Request(NamedTuple):
    """The solution of ``system`` on [0, t_end] by ``method``, output at t_eval (k,), None for 2001 times.

    Those below are for the adaptive solvers, but for digits, a number or "auto", of multiprecision. atol: None for
    rtol/100 of the scale of every unknown. breakpoints: times of a restart. second: a second opinion,
    with shorter steps that lie at other times.
    """

    system: System
    t_end: float
    method: str
    t_eval: Array | None = None
    rtol: float = RTOL
    atol: float | None = None
    digits: int | str = "auto"
    breakpoints: ArrayLike = ()
    second: bool = False


def provenance_of(system: System, method: str, t_end: float, notes: dict[str, Any]) -> dict[str, Any]:
    """Provenance of a reference: what all have, and the ``notes`` of its method."""
    from ..trajectory.trajectory import versions

    return {
        "method": method,
        "form": system.form,
        "units": list(system.units),
        "t_end": float(t_end),
        **REFERENCES[method].versions(),
        **notes,
        **versions(),
    }


def output_times(t_eval: Array | None, t_end: float) -> Array:
    """t_eval, (k,), or 2001 equidistant times in [0, t_end].

    Raises InputError where they are fewer than two, do not increase, or leave [0, t_end].
    """
    if t_eval is None:
        t = np.linspace(0.0, t_end, OUTPUTS)
        # In a span of a few of float64's smallest numbers equidistant times are no longer distinct.
        if not np.all(np.diff(t) > 0.0):
            raise InputError("t_end", t_end, "be long enough for 2001 output times in float64", "pass t_eval")
        return t
    t = np.asarray(t_eval, float)
    # Every comparison with NaN is false: all of them have to hold.
    if t.ndim != 1 or len(t) < 2 or not (np.all(np.diff(t) > 0.0) and t[0] >= 0.0 and t[-1] <= t_end * (1 + 1e-12)):
        rule = f"be two or more increasing times in [0, {t_end:g}]"
        raise InputError("t_eval", t, rule, "for a comparison pass t_eval=run.t")
    # The last time of a run may pass t_end by rounding.
    return np.minimum(t, t_end)


def filled(times: Array, t_end: float) -> Array:
    """The output times (k,), and others on [0, t_end] where they are farther apart than by default."""
    edges = np.union1d(times, [0.0, t_end])
    parts = np.ceil(np.diff(edges) * (OUTPUTS - 1) / t_end * (1.0 - 1e-9)).astype(int)
    between = (np.linspace(a, b, n, endpoint=False) for a, b, n in zip(edges[:-1], edges[1:], parts, strict=True))
    return np.append(np.concatenate([*between]), t_end)
