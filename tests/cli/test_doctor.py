"""What the doctor says of this machine, and of one where a solver is broken."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

import stiffbeam as sb
from stiffbeam.references import registry


@pytest.mark.slow
def test_every_solver_works_here(command):
    code, out, _ = command("doctor", "--json", "-")
    found = json.loads(out)
    assert code == 0
    assert {solver["name"] for solver in found["solvers"]} == {"SDIRK", *registry.METHODS}
    assert all(solver["agrees"] and solver["error"] < 1e-3 for solver in found["solvers"])
    assert found["installed"]["stiffbeam"] == found["installed"]["stiffbeam"].strip() != "missing"


def test_a_broken_solver_is_named_and_the_others_go_on(command, monkeypatch):
    real = sb.reference

    def broken(system, end, method="exact", t_eval=None, **options):
        if method == "ida":
            raise ImportError("no library")
        return real(system, end, "exact", t_eval)

    monkeypatch.setattr("stiffbeam.references.reference", broken)
    code, out, _ = command("doctor")
    assert code == 1
    rows = [line.split() for line in out.splitlines() if "works" in line or "fails" in line]
    assert {row[0] for row in rows if "fails," in row} == {"ida"}
    assert "ImportError: no library" in " ".join(out.split())


@pytest.mark.slow
def test_the_package_is_a_program():
    done = subprocess.run([sys.executable, "-m", "stiffbeam", "--version"], capture_output=True, text=True)
    assert done.stdout.startswith("stiffbeam ")


@pytest.mark.slow
def test_an_extra_that_is_not_installed_is_no_fault(command, monkeypatch):
    """The doctor and the study of precision leave its method out."""
    from dataclasses import replace

    from stiffbeam.studies import precision

    missing = replace(registry.REFERENCES["heyoka"], libraries={"heyoka": "no-such-distribution"})
    monkeypatch.setitem(registry.REFERENCES, "heyoka", missing)
    real = sb.reference
    monkeypatch.setattr(
        "stiffbeam.references.reference", lambda s, end, *_, t_eval=None, **options: real(s, end, t_eval=t_eval)
    )
    code, out, _ = command("doctor", "--json", "-")
    solvers = {solver["name"] for solver in json.loads(out)["solvers"]}
    assert code == 0
    assert "heyoka" not in solvers
    assert "radau" in solvers
    plan = precision.points(sb.paper_case(10), form="displacement", dt=1e-4, schemes=["hht"], halvings=1, impacts=1)
    assert {"cvode"} <= {point["method"] for point in plan}
    assert "heyoka" not in {point["method"] for point in plan}
