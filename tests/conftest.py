"""Shared problems: the paper's Table 10 and small smooth systems."""

from __future__ import annotations

import gc
import os
import signal
import sys
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "agg")
# Before NumPy is there, and inherited by pytest's workers: on all cores at once, BLAS threads only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

sys.path.append(str(Path(__file__).parents[1] / "studies"))  # for dumont2002
sys.path.append(str(Path(__file__).parents[1] / "studies" / "how-to"))

# A shell's background jobs ignore it, and so would every command that a test starts and interrupts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

import hypothesis
import pytest
from commands import invoke

import stiffbeam as sb
from stiffbeam.basics import resources

# The same examples in every run, so that a failure comes again; ``--hypothesis-profile=default`` makes fresh ones. On a
# busy machine one takes longer than the 200 ms that Hypothesis allows.
hypothesis.settings.register_profile("repeatable", deadline=None, derandomize=True)
hypothesis.settings.load_profile("repeatable")

pytest_plugins = ["pytester"]
resources.WAIT = 600.0  # however busy the machine, no test prints a line about its work


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """What is collected stays to the end: looking for garbage in it again and again takes a tenth of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Of a test marked ``fast(n, slow=m)`` n parametrisations, spread evenly, stay in the fast suite.

    m others, spread evenly too, are slow, all of them without ``slow``; the rest is for campaigns, which have no time
    limit. A campaign runs only if -m names campaigns: a -m of the command line replaces the one of pyproject.toml.
    """
    kinds: dict[str, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("fast"):
            kinds.setdefault(item.nodeid.partition("[")[0], []).append(item)
    for same in kinds.values():
        share = same[0].get_closest_marker("fast")
        slow = [item for item in same if item not in _spread(same, share.args[0])]
        some = _spread(slow, share.kwargs.get("slow", len(slow)))
        for item in slow:
            item.add_marker("slow" if item in some else "campaign")
    for item in items:
        if item.get_closest_marker("campaign"):
            item.add_marker(pytest.mark.timeout(0))  # they take what they take
    if "campaign" not in str(config.getoption("markexpr")):
        config.hook.pytest_deselected(items=[item for item in items if item.get_closest_marker("campaign")])
        items[:] = [item for item in items if not item.get_closest_marker("campaign")]


def _spread(items: list[pytest.Item], n: int) -> list[pytest.Item]:
    """``n`` of the items, spread evenly, or all that there are."""
    return [items[len(items) * k // n] for k in range(n)] if n < len(items) else items


@pytest.fixture(scope="session")
def table10() -> sb.BeamProblem:
    return sb.BeamProblem(
        stiffness=300.0, stops=sb.Stops(-0.1, 0.1, stiffness=5e6), base=sb.Harmonic(amplitude=0.2, frequency=10.0)
    )


@pytest.fixture(scope="session", params=["displacement", "velocity-curvature"])
def table10_system(request, table10) -> sb.System:
    return sb.semidiscretise(table10, 25, request.param)


@pytest.fixture
def jax_in_float64():
    import jax

    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


@pytest.fixture
def command(tmp_path, monkeypatch):
    """The command in this process and in an empty folder: (exit code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        done = invoke(arguments)
        return done.exit_code, done.stdout, done.stderr

    return run
