"""The reference solvers and what is known of each. A new one is one file and one line here.

Everything that lists solvers reads this: ``reference`` and its commands, the cache, studies, pictures, tests.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version

EXACT, MULTIPRECISION, ADAPTIVE = "exact", "multiprecision", "adaptive"


@dataclass(frozen=True)
class Method:
    """A reference solver.

    name: what users write. module: in this folder, with ``solve(request) -> Reference``. label: its name in
    pictures. look: the number of its dashes and marker there, which no other has and which stays. seconds:
    what Table 10 takes to t = 0.06 at rtol 1e-6, roughly, for those who run the fast ones first or leave
    the slow ones out. kind: EXACT (closed form between switches, in float64), MULTIPRECISION (the same in
    many digits) or ADAPTIVE (error control: takes rtol, atol and Steps). libraries: import name and
    distribution of what it needs. roots: whether it finds switches as roots; only then are its impacts
    events, and only then can it restart at them.
    """

    name: str
    module: str
    label: str
    look: int
    seconds: float
    kind: str = ADAPTIVE
    libraries: dict[str, str] = field(default_factory=dict)
    roots: bool = True

    def versions(self) -> dict[str, str]:
        """The versions of its libraries by distribution, "missing" for one that is not installed."""
        found = {}
        for package in self.libraries.values():
            try:
                found[package] = version(package)
            except PackageNotFoundError:
                found[package] = "missing"
        return found


_SCIPY, _SUNDIALS, _FLINT = {"scipy": "scipy"}, {"sksundae": "scikit-sundae"}, {"flint": "python-flint"}
_DIFFRAX = {"diffrax": "diffrax", "jax": "jax"}
REFERENCES = {
    method.name: method
    for method in (
        Method("exact", "exact.piecewise", "exact", 0, 0.004, EXACT),
        Method("multiprecision", "multiprecision.multiprecision", "multiprecision", 1, 0.13, MULTIPRECISION, _FLINT),
        Method("cvode", "adaptive.cvode", "CVODE BDF", 2, 0.4, libraries=_SUNDIALS),
        Method("cvode-adams", "adaptive.cvode", "CVODE Adams", 3, 0.3, libraries=_SUNDIALS),
        Method("ida", "adaptive.ida", "IDA", 4, 0.6, libraries=_SUNDIALS),
        Method("kvaerno3", "adaptive.kvaerno", "Kvaerno3", 5, 11.0, libraries=_DIFFRAX, roots=False),
        Method("kvaerno5", "adaptive.kvaerno", "Kvaerno5", 6, 2.0, libraries=_DIFFRAX, roots=False),
        Method("dop853", "adaptive.scipy", "DOP853", 7, 0.45, libraries=_SCIPY),
        Method("radau", "adaptive.scipy", "Radau", 8, 3.5, libraries=_SCIPY),
        Method("lsoda", "adaptive.lsoda", "LSODA", 9, 0.6, libraries=_SCIPY),
    )
}
METHODS = tuple(REFERENCES)
RTOL = 1e-10  # of an adaptive reference by default
BEST = ("exact", "cvode-adams", "dop853")  # the first that takes a system is the best reference of it
COMPARED = ("exact", "cvode-adams", "cvode", "ida", "kvaerno5")  # references of a comparison by default
BUDGET = 60.0  # seconds that one reference of a comparison may take by default
COMPARED_RIGID = ("exact",)  # on rigid stops, which no other takes
