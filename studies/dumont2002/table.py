"""One table of the paper: its runs beside the true motion of every form that they use."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

import stiffbeam as sb
from stiffbeam.basics.arrays import Array
from stiffbeam.basics.validation import one_of
from stiffbeam.files.cases import Case
from stiffbeam.march.treatment import TREATMENTS
from stiffbeam.schemes import PrintedSigma, UnweightedHHT

from .references import STORE, frozen

LONGEST_HORIZON = 1.0  # no table's float64 horizon reaches half of it
PRINTED: dict[type[sb.Scheme], type[sb.Scheme]] = {sb.HHT: UnweightedHHT, sb.SDIRK: PrintedSigma}


@dataclass(frozen=True)
class Reading:
    """Reading of the paper where it is silent or in error.

    Parameters
    ----------
    contact : str
        "implicit", or "extrapolated" as the paper describes it.
    printed : bool
        HHT and SDIRK with the misprint that runs at any step: (4.13) unweighted, the sign of sigma. BDF2 has none.
    """

    contact: str = "implicit"
    printed: bool = False

    def __post_init__(self) -> None:
        one_of("contact", self.contact, TREATMENTS)

    def scheme(self, scheme: sb.Scheme) -> sb.Scheme:
        """``scheme`` as this reading has it."""
        kind = PRINTED.get(type(scheme)) if self.printed else None
        return scheme if kind is None else kind(**scheme.parameters)


@dataclass(frozen=True)
class Table:
    """Runs and failures of a table by the paper's equation number; systems, true motions and float64 horizons by form.

    failures: messages of the runs that overflowed.
    """

    case: Case
    reading: Reading
    systems: dict[str, sb.System]
    references: dict[str, sb.Reference]
    horizons: dict[str, float]
    runs: dict[str, sb.Trajectory]
    failures: dict[str, str]

    @property
    def stops(self) -> sb.Stops:
        """The stops of the tip."""
        return self.case.beam.all_stops[0]

    @property
    def drive(self) -> float:
        """The angular frequency that drives the beam."""
        return drive_of(self.case).frequency

    @property
    def steps(self) -> int:
        """Steps of a run."""
        return round(self.case.t_end / self.case.dt)

    @property
    def number(self) -> int:
        """The table's number in the paper."""
        return int(self.case.name.removeprefix("table"))


def drive_of(case: Case) -> sb.Harmonic:
    """The motion of the base, or the load where the base rests."""
    time = case.beam.base if case.beam.base is not None else case.beam.loads[0].time
    assert isinstance(time, sb.Harmonic)
    return time


def equations(case: Case) -> dict[str, tuple[sb.Scheme, str]]:
    """Scheme and form of every run of the case, by the paper's equation number."""
    return {equation_of(*run): run for run in case.runs}


def equation_of(scheme: sb.Scheme, form: str) -> str:
    """The paper's number for ``scheme`` on ``form``: (4.5), (4.10), (4.11), (4.12), (4.13) or (4.14)."""
    if isinstance(scheme, sb.SDIRK):
        return "(4.14)" if scheme.nystrom else "(4.10)" if form == "velocity-curvature" else "(4.12)"
    if isinstance(scheme, sb.HHT):
        return "(4.13)"
    return "(4.5)" if form == "velocity-curvature" else "(4.11)"


def published(case: Case, kind: str) -> dict[str, float]:
    """The paper's "cpu_seconds" or "impacts" of a table by equation number; it has impacts for Tables 10 to 13 only."""
    values = case.published.get(kind, {})
    labels = {equation: "{}@{}".format(*run) for equation, run in equations(case).items()}
    return {equation: values[label] for equation, label in labels.items() if label in values}


def make_table(case: Case, reading: Reading) -> Table:
    """The runs of ``case`` as ``reading`` has them, beside the true motions.

    A run that overflows is noted in ``failures`` and the others go on.
    """
    systems = {form: case.system(form) for form in dict.fromkeys(form for _, form in case.runs)}
    true = {form: frozen(STORE, case, form) for form in systems}
    end = min(case.t_end, LONGEST_HORIZON)
    horizons = {form: sb.reference(system, end).horizon for form, system in systems.items()}
    runs, failures = dict[str, sb.Trajectory](), dict[str, str]()
    for equation, (scheme, form) in equations(case).items():
        try:
            runs[equation] = sb.integrate(systems[form], reading.scheme(scheme), case.dt, case.t_end, reading.contact)
        except sb.Diverged as error:
            failures[equation] = str(error)
    return Table(case, reading, systems, true, horizons, runs, failures)


def roots(count: int) -> Array:
    """l_1 .. l_count with cos l cosh l = -1: the clamped-free beam; w_i = l_i^2 k."""
    centres = (np.arange(1, count + 1) - 0.5) * np.pi  # the i-th root is within 0.31 of it
    return np.array([brentq(lambda x: np.cos(x) + 1.0 / np.cosh(x), c - 0.5, c + 0.5, xtol=1e-15) for c in centres])
