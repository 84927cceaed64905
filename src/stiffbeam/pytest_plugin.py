"""pytest plugin: references with a bound for other people's tests of their integrators."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from .trajectory.trajectory import Reference, Trajectory


@pytest.fixture(scope="session")
def reference_solution() -> Callable[..., Reference]:
    """``reference_solution(case_or_system, t_end=None, **options)``.

    A multiprecision reference, of rigid stops an exact one, computed once and cached between test runs. A case is
    named ("table10", a file) or passed, and ends at its own t_end by default. options: those of
    ``stiffbeam.cached_reference``, as method="cvode", t_eval=times, rtol=1e-9.
    """
    from .basics.validation import InputError
    from .files.cases import Case, find_case
    from .files.store import cached_reference
    from .model.system import System

    def make(what: Any, t_end: float | None = None, **options: Any) -> Reference:
        case = find_case(what) if isinstance(what, str) else what
        if isinstance(case, Case):
            case, t_end = case.system(), t_end or case.t_end
        if not isinstance(case, System) or t_end is None:
            rule, remedy = "be a case, its name, or a System with t_end", "for example reference_solution('table10')"
            raise InputError("reference_solution", what, rule, remedy)
        chosen: dict[str, Any] = {"method": "exact" if case.rigid else "multiprecision"} | options
        return cached_reference(case, t_end, **chosen)

    return make


@pytest.fixture(scope="session")
def assert_within_reference() -> Callable[..., None]:
    """``assert_within_reference(run, reference, tolerance, until=None)``, see ``within_reference``."""
    return within_reference


def within_reference(
    run: Trajectory | tuple[Any, ...] | list[Any], reference: Reference, tolerance: float, until: float | None = None
) -> None:
    """Assert |u_run - u_ref| <= tolerance max |u_ref| at the run's times up to ``until`` (default: its end).

    run: a Trajectory, or arrays as ``compare`` takes them. Raises InputError for what would prove nothing: a time past
    the horizon of the reference, where no solution is known to compare with, a reference without a horizon, a run of
    another system, times that decrease, numbers that are complex or not finite.
    """
    __tracebackhide__ = True  # the report shows the test, not this function
    import numpy as np

    from .basics.validation import InputError, positive
    from .measures.errors import relative_error, run_of

    tolerance, run = positive("tolerance", tolerance), run_of(run, reference, "run")
    end = float(run.t[-1]) if until is None else positive("until", until)
    if not end <= reference.horizon * (1 + 1e-12):
        remedy = "pass until=reference.horizon or a reference that reaches further"
        raise InputError("until", end, f"be at most the horizon {reference.horizon:g}", remedy)
    t = run.t[run.t <= end * (1 + 1e-12)]
    error = np.abs(relative_error(run.tip[: len(t)], reference.at(t)[0]))
    worst = int(np.argmax(error))
    assert error[worst] <= tolerance, (
        f"off by {error[worst]:.3e} of the largest displacement at t = {t[worst]:.6g}, allowed {tolerance:.3e}"
    )


def pytest_generate_tests(metafunc: Any) -> None:
    """A test that takes ``known_problem`` runs once for every problem of the test set."""
    if "known_problem" in metafunc.fixturenames:
        from .testset.problem import problems

        known = problems()
        metafunc.parametrize("known_problem", list(known.values()), ids=list(known))
