"""What the doctor says of this machine, and of one where a solver is broken."""

from __future__ import annotations

import json
import os
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
    real = sb.score

    def broken(name, *arguments):
        if name == "ida":
            raise ImportError("no library")
        return real("trapezoidal", *arguments)

    monkeypatch.setattr("stiffbeam.testset.score.score", broken)
    code, out, _ = command("doctor")
    assert code == 1
    rows = [line.split() for line in out.splitlines() if "works" in line or "fails" in line]
    assert {row[0] for row in rows if "fails," in row} == {"ida"}
    assert "ImportError: no library" in " ".join(out.split())


WITHOUT_A_DEVICE = """
import sys
import stiffbeam as sb
from stiffbeam.cli import commands, main

try:
    sb.reference(sb.problem("bilinear-gap").system, 0.01, "kvaerno3", rtol=1e-4)
except sb.InputError as error:
    print(error, file=sys.stderr)
commands._solvers = lambda show: []
sys.argv = ["stiffbeam", "doctor"]
main()
"""


@pytest.mark.slow
@pytest.mark.parametrize("platform", ["tpu", "cuda"])
def test_where_jax_finds_no_device_the_remedy_is_said(platform):
    """A graphics card without free memory is one that does not start."""
    environment = {**os.environ, "JAX_PLATFORMS": platform, "COLUMNS": "400"}
    done = subprocess.run([sys.executable, "-c", WITHOUT_A_DEVICE], env=environment, capture_output=True, text=True)
    if platform == "cuda" and not done.stderr:
        pytest.skip("there is a graphics card")
    assert done.returncode == 0
    for said in (done.stdout, done.stderr):
        assert "JAX must start its devices" in said
        assert "set JAX_PLATFORMS=cpu" in said
