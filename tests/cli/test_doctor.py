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
    assert all(solver["agrees"] for solver in found["solvers"])
    assert "missing" not in found["installed"].values()


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


@pytest.mark.slow
def test_where_jax_finds_no_device_the_remedy_is_stated():
    code = "import stiffbeam as sb; sb.reference(sb.problem('bilinear-gap').system, 0.01, 'kvaerno3', rtol=1e-4)"
    environment = {**os.environ, "JAX_PLATFORMS": "tpu"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert "JAX must start its devices" in done.stderr
    assert "set JAX_PLATFORMS=cpu" in done.stderr
