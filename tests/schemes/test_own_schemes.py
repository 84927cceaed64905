"""A scheme of one's own in studies, in other processes and on the command line."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.schemes.labels import parse_run


class Midpoint(sb.Scheme):
    """k = f(t + theta dt, y + theta dt k): the implicit midpoint rule at theta = 1/2."""

    def __init__(self, theta: float = 0.5) -> None:
        self.theta, self.nodes = theta, (theta,)

    @property
    def parameters(self):
        return {"theta": self.theta}

    def step(self, equation, dt, z, loads, reactions):
        k = equation.implicit_rate(self.theta * dt, z, loads[0] + reactions[0])
        return z + dt * k, [z + self.theta * dt * k]


class Secretive(Midpoint):
    @property
    def parameters(self):
        return {}


def test_a_label_that_names_no_scheme_is_refused():
    assert parse_run(" test_own_schemes:Midpoint(theta=0.6) @ velocity-curvature")[1] == "velocity-curvature"
    for label, says in (
        ("no_such_module:Central", "can be imported"),
        ("test_own_schemes.py:Midpoint", r"can be imported, got .*: write test_own_schemes:Midpoint$"),
        ("test_own_schemes:Midpiont", "did you mean Midpoint"),
        ("test_own_schemes:zzzz", "known: Midpoint, Secretive, "),
        ("test_own_schemes:np", "Scheme class"),
        ("test_own_schemes:Midpoint(gamma=1)", "one of its own"),
    ):
        with pytest.raises(sb.InputError, match=says):
            parse_run(label)


@pytest.mark.slow
def test_a_study_takes_scheme_objects_in_worker_processes_too(tmp_path):
    """Both are the implicit midpoint rule on a linear problem: the trapezoidal rule by another name."""
    options = {"schemes": [Midpoint(), sb.Trapezoidal()], "steps": 64}
    here = sb.study("modes", sb.paper_case(10), folder=tmp_path, **options)
    there = sb.study("modes", sb.paper_case(10), jobs=2, **options)
    assert here.table.equals(there.table)
    assert set(here.found.scheme) == {"Midpoint(theta=0.5)", "Trapezoidal"}
    assert not here.lost
    here.figure()


@pytest.mark.slow
def test_a_scheme_of_the_current_folder_runs_on_the_command_line(tmp_path):
    (tmp_path / "mine.py").write_text(
        "import stiffbeam as sb\n\nclass Euler(sb.Scheme):\n    order = 1\n"
        "    def step(self, equation, dt, z, loads, reactions):\n"
        "        y = z + dt * equation.implicit_rate(dt, z, loads[0] + reactions[0])\n        return y, [y]\n"
    )
    command = [sys.executable, "-m", "stiffbeam", "compare", "table10", "--t-end", "0.02", "--schemes"]
    done = subprocess.run(
        [*command, "mine:Euler,bdf2", "--references", "exact", "--out", "out"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "Euler" in done.stdout
    done = subprocess.run([*command, "mine:Eulr"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2
    assert "did you mean Euler" in " ".join(done.stderr.split())


@pytest.mark.slow
def test_an_integrator_of_ones_own_reads_all_it_needs_from_the_system(table10):
    """Runge and Kutta's method on ``rhs``, and semi-implicit Euler on matrices, loads and contacts; both scored."""
    system = sb.semidiscretise(table10, 8)
    t_end, dt = 0.06, 5e-6
    t = np.arange(round(t_end / dt) + 1) * dt
    ode = system.ode()
    y = np.empty((len(t), len(ode.y0)))
    y[0] = ode.y0
    for k in range(len(t) - 1):
        a = ode.rhs(t[k], y[k])
        b = ode.rhs(t[k] + dt / 2, y[k] + dt / 2 * a)
        c = ode.rhs(t[k] + dt / 2, y[k] + dt / 2 * b)
        d = ode.rhs(t[k] + dt, y[k] + dt * c)
        y[k + 1] = y[k] + dt / 6 * (a + 2 * b + 2 * c + d)
    q, v = ode.displacement(y), ode.velocity(y)
    row, offset = system.channels[system.tip_channel]
    assert offset is None
    ref = sb.reference(system, t_end)
    scored = sb.compare((t, q @ row, v @ row), ref)
    assert scored.contacts[0].run.impacts == ref.impacts_sampled(dt).count > 0
    assert scored.tip_error_max < 1e-4  # the kink of the contact law leaves order two

    # By hand: loads are pairs (vector, function), contacts have a row, stops and an offset.
    inverse = np.linalg.inv(system.mass)
    q, v, tip = system.q0.copy(), system.v0.copy(), [system.q0 @ row]
    for time in t[1:]:
        force = sum((p * f.value(time) for p, f in system.loads), -system.stiffness @ q - system.damping @ v)
        for contact in system.contacts:
            force = force + contact.row * contact.stops.force(contact.row @ q)
        v = v + dt * (inverse @ force)
        q = q + dt * v
        tip.append(q @ row)
    assert sb.compare((t, np.array(tip)), ref).tip_error_rms < 0.05
