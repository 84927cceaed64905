"""One table of the paper: its runs, and the exact solution of every form that they use."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from stiffbeam.basics.validation import InputError, one_of
from stiffbeam.files.cases import Case
from stiffbeam.march.integrate import integrate
from stiffbeam.march.treatment import TREATMENTS
from stiffbeam.model.contact import Stops
from stiffbeam.model.semidiscretisation import semidiscretise
from stiffbeam.model.system import System
from stiffbeam.model.time_functions import Harmonic
from stiffbeam.references import reference
from stiffbeam.schemes import HHT, SDIRK, PrintedSigma, Scheme, UnweightedHHT
from stiffbeam.trajectory.trajectory import Diverged, Reference, Trajectory

from .references import MANIFEST, STORE, frozen

LONGEST_HORIZON = 1.0  # no table's float64 horizon reaches half of it


PRINTED: dict[type[Scheme], type[Scheme]] = {HHT: UnweightedHHT, SDIRK: PrintedSigma}


@dataclass(frozen=True)
class Reading:
    """Reading of the paper where it is silent or in error.

    Parameters
    ----------
    contact : str
        "implicit", or "extrapolated" as the paper describes it.
    printed : bool
        HHT and SDIRK with the misprint that runs at any step: (4.13) unweighted, the sign of sigma. BDF2 has none.
    references : str, optional
        Folder of frozen multiprecision solutions; None for the exact solution in float64.
    """

    contact: str = "implicit"
    printed: bool = False
    references: str | None = None

    def __post_init__(self) -> None:
        one_of("contact", self.contact, TREATMENTS)

    @classmethod
    def of(cls, contact: str, printed: bool, references: Path | None) -> Reading:
        """Reading with the given folder of references, or the one that is there."""
        folder = STORE if references is None else references
        if not (folder / MANIFEST).is_file():
            raise InputError("--references", str(folder), f"hold a {MANIFEST}", "leave it out for that of the checkout")
        return cls(contact, printed, str(folder.resolve()))

    def scheme(self, scheme: Scheme) -> Scheme:
        """``scheme`` as this reading has it."""
        kind = PRINTED.get(type(scheme)) if self.printed else None
        return scheme if kind is None else kind(**scheme.parameters)

    @property
    def name(self) -> str:
        """Name of a folder: "implicit-corrected", "extrapolated-printed"."""
        return f"{self.contact}-{'printed' if self.printed else 'corrected'}"


@dataclass(frozen=True)
class Made:
    """Runs of a table, by the paper's equation number, beside references and horizons of float64 by form.

    failures: by equation number.
    """

    case: Case
    reading: Reading
    systems: dict[str, System]
    runs: dict[str, Trajectory] = field(default_factory=dict)
    references: dict[str, Reference] = field(default_factory=dict)
    horizons: dict[str, float] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)

    @property
    def equations(self) -> dict[str, tuple[Scheme, str]]:
        """Scheme and form of every run of the case, by the paper's equation number."""
        return {equation_of(*run): run for run in self.case.runs}

    @property
    def stops(self) -> Stops:
        """The stops of the tip."""
        return self.case.beam.all_stops[0]

    @property
    def drive(self) -> float:
        """The angular frequency of the base, or of the load where the base rests."""
        return drive_of(self.case)

    def known(self, form: str) -> bool:
        """Return True if the reference of ``form`` is true over the whole span: a multiprecision solution."""
        return self.references[form].provenance["method"] == "multiprecision"

    @property
    def number(self) -> int:
        """The table's number in the paper."""
        return int(self.case.name.removeprefix("table"))


def drive_of(case: Case) -> float:
    """The angular frequency that drives ``case``."""
    time = case.beam.base if case.beam.base is not None else case.beam.loads[0].time
    assert isinstance(time, Harmonic)
    return time.frequency


def equation_of(scheme: Scheme, form: str) -> str:
    """The paper's number for ``scheme`` on ``form``: (4.5), (4.10), (4.11), (4.12), (4.13) or (4.14)."""
    if isinstance(scheme, SDIRK):
        return "(4.14)" if scheme.nystrom else "(4.10)" if form == "velocity-curvature" else "(4.12)"
    if isinstance(scheme, HHT):
        return "(4.13)"
    return "(4.5)" if form == "velocity-curvature" else "(4.11)"


def make_table(case: Case, reading: Reading) -> Made:
    """The runs of ``case`` as ``reading`` has them, beside the exact solution over the whole span.

    A run that overflows is noted in ``failures`` and the others go on.
    """
    forms = dict.fromkeys(form for _, form in case.runs)
    made = Made(case, reading, {form: semidiscretise(case.beam, case.cells, form) for form in forms})
    for form, system in made.systems.items():
        made.references[form], made.horizons[form] = exact_solution(case, form, system, reading)
    for equation, (scheme, form) in made.equations.items():
        chosen = reading.scheme(scheme)
        try:
            made.runs[equation] = integrate(made.systems[form], chosen, case.dt, case.t_end, reading.contact)
        except Diverged as error:
            made.failures[equation] = str(error)
    return made


def exact_solution(case: Case, form: str, system: System, reading: Reading) -> tuple[Reference, float]:
    """(reference over the case's span, horizon of float64).

    The frozen multiprecision solution where the reading's folder has it; else the exact solution in float64, which past
    its horizon is one realisation of the motion.
    """
    if reading.references is not None:
        found = frozen(Path(reading.references), case, form)
        if found is not None:
            return found, reference(system, min(case.t_end, LONGEST_HORIZON)).horizon
    exact = reference(system, case.t_end)
    return exact, exact.horizon
