"""Studies: each answers a question about a case with records. A new study is one module and one line here."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ..basics.validation import one_of

if TYPE_CHECKING:
    from .interface import Records, Study

# In this order: one step, one run, many runs, many steps.
STUDIES = {
    "amplification": "Spectral radius, period elongation and damping of one step on a free oscillation.",
    "modes": "Phase lag and damping of every mode without contact, against theory.",
    "energy": "Energy balance of every scheme and of the exact solution, in every form.",
    "converge": "Observed orders in time, without contact and through it.",
    "space": "Convergence of both discretisations to the beam, and of the contact.",
    "first_impact": "Force of the first impact, from 10 to 640 cells, against the theory of a point contact.",
    "rigid": "Convergence to rigid stops: kappa to infinity.",
    "rigid_beam": "The beam from soft stops to rigid ones: impulse, time in contact, energy, scheme by scheme.",
    "restitution": "Requested and delivered restitution of the usual formulas for the damping of a stop.",
    "rigid_bar": "Every scheme against the exact solution of a bar that bounces on a rigid wall.",
    "errata": "Error of each misprint of the paper.",
    "impacts": "Impact counts against the time step, with the exact count.",
    "contact_duration": "Durations of contacts: errors inside the horizon, distributions past it.",
    "precision": "Work-precision diagram: error against seconds and against work.",
    "ensemble": "Statistics past the horizon: impacts, time in contact, forces and energy of perturbed runs.",
    "chaos": "Lyapunov exponents of the exact motion and of the schemes; delayed phase portrait.",
    "sweep": "Bifurcation diagram, impacts and forces over one or two parameters; continues after an interruption.",
    "orbits": "Periodic orbits over a parameter, stable or not, with flips and multipliers.",
}


def __getattr__(name: str) -> Any:
    """Records and Study, loaded on first use: with them come SciPy and numba, which a list of studies does without."""
    if name in ("Records", "Study"):
        return getattr(import_module(".interface", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def find_study(name: str) -> Study:
    """The registered study ``name``, as the command or the module writes it. Raises InputError for any other name."""
    name = name.replace("-", "_") if isinstance(name, str) else name
    one_of("study", name, STUDIES, "be a registered study")
    return import_module(f".{name}", __name__).STUDY


def study(name: str, case: Any = "table10", **options: Any) -> Records:
    """Return the records of a study on a case or system.

    Parameters
    ----------
    name : str
        One of ``stiffbeam --help``, such as "converge", "precision", "energy".
    case : str, Case or System
        The label of a case, a case, or a system of your own (with dt= and t_end=).
    **options
        ``progress=True`` for a bar, ``jobs=`` for processes or your ``executor=``, ``folder=`` to go on after an
        interruption, and those of the study itself, as its command lists them.

    Returns
    -------
    Records
        With ``answer`` (text), ``to_dataframe()``, ``figure()`` and ``save()``.

    Raises
    ------
    InputError
        For an unknown study, an unknown option, and a case that the study cannot take.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> records = sb.study("amplification", schemes=["BDF2", "HHT(alpha=-0.1)"], per_decade=3)
    >>> "scheme" in records.to_dataframe()
    True
    """
    from .runner import run_study

    return run_study(find_study(name), case, **options)


__all__ = ["STUDIES", "Records", "Study", "find_study", "study"]
