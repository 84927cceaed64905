"""Every scheme for rigid stops changes the energy by what its docstring says, step by step."""

from __future__ import annotations

import numpy as np
import pytest
from rigid_chain import chain

import stiffbeam as sb


def steps_of(system, scheme, dt, steps):
    """q, v, reactions (steps, contacts), energies, impulses of the load, all of an undamped system at every step."""
    run = sb.integrate(system, scheme, dt, steps * dt)
    q, v = run.states
    R = np.stack([c.force[1:] for c in run.contacts], axis=1)
    assert np.any(R)
    return run, q, v, R, system.energy(run.t, q, v)


@pytest.mark.parametrize("e", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("theta", [0.5, 0.6, 1.0])
def test_the_energy_of_moreau_and_jean(theta, e):
    """The docstring's identity; its last term where the law of restitution is met with equality."""
    system, _ = chain(2, e=e)
    dt = 0.02
    run, q, v, R, E = steps_of(system, sb.MoreauJean(theta), dt, 400)
    f = system.load(run.t)
    dq, dv = np.diff(q, axis=0), np.diff(v, axis=0)
    work = np.sum(((1.0 - theta) * f[:-1] + theta * f[1:]) * dq, axis=1)
    squares = np.sum(dv * (dv @ system.mass) + dq * (dq @ system.stiffness), axis=1)
    U = v @ np.array([c.row for c in system.contacts]).T
    of_impacts = (1.0 - theta * (1.0 + e)) * np.sum(U[:-1] * dt * R, axis=1)
    rest = np.diff(E) - work - (0.5 - theta) * squares - of_impacts
    assert np.max(np.abs(rest)) < 1e-12 * np.max(E)


@pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
def test_the_energy_of_paoli_and_schatzman(e):
    system, loop = chain(2, e=e)
    dt, beta = 0.02, 0.3
    run, q, v, R, _ = steps_of(system, sb.PaoliSchatzman(beta), dt, 400)
    middle = q[1:] - 0.5 * dt * v[1:]
    K, M = system.stiffness, system.mass
    E = 0.5 * np.sum(v[1:] * (v[1:] @ (M + (beta - 0.25) * dt**2 * K)) + middle * (middle @ K), axis=1)
    across = q[2:] - q[:-2]
    work = 0.5 * np.sum(system.load(run.t)[1:-1] * across, axis=1)
    side = np.where(R[1:] < 0.0, loop.upper, loop.lower)
    with np.errstate(invalid="ignore"):
        gap = np.where(R[1:] != 0.0, (q @ loop.B.T)[:-2] - side, 0.0)
    taken = (1.0 + e) * np.sum(R[1:] * gap, axis=1) / 2.0
    assert np.max(np.abs(np.diff(E) - work + taken)) < 1e-12 * np.max(E)


def test_the_energy_of_the_contact_stabilised_scheme():
    system, _ = chain(2)
    dt = 0.02
    run, q, v, R, E = steps_of(system, sb.ContactStabilisedNewmark(), dt, 400)
    B, f = np.array([c.row for c in system.contacts]), system.load(run.t)
    dq, a = np.diff(q, axis=0), np.diff(v, axis=0) / dt
    put_back = (dq - dt * v[:-1] - 0.5 * dt**2 * a) @ system.mass  # B^T nu
    work = np.sum(0.5 * (f[1:] + f[:-1]) * dq, axis=1)
    rest = np.diff(E) - work - np.sum(R * (dq @ B.T), axis=1) + np.sum(put_back * a, axis=1)
    assert np.max(np.abs(rest)) < 1e-12 * np.max(E)
    assert np.any(np.abs(put_back) > 1e-6)
    assert np.max(np.abs(np.delete(put_back, [3, 1], axis=1))) < 1e-13  # at the contacts only


@pytest.mark.parametrize("e", [0.0, 0.7])
def test_the_energy_of_the_nonsmooth_generalised_alpha_scheme(e):
    system, _ = chain(2, e=e)
    dt = 0.02
    run, q, v, R, E = steps_of(system, sb.NonsmoothGeneralisedAlpha(1.0), dt, 400)
    B, f = np.array([c.row for c in system.contacts]), system.load(run.t)
    dq, mean_q, mean_f = np.diff(q, axis=0), 0.5 * (q[1:] + q[:-1]), 0.5 * (f[1:] + f[:-1])
    a = np.linalg.solve(system.mass, (mean_f - mean_q @ system.stiffness).T).T
    nu = ((dq - dt * v[:-1] - 0.5 * dt**2 * a) @ system.mass) @ B.T
    U, P = 0.5 * (v[1:] + v[:-1]) @ B.T, dt * R
    rest = np.diff(E) - np.sum(mean_f * dq, axis=1) - np.sum(P * U + (0.5 * dt * P - nu) * (a @ B.T), axis=1)
    assert np.max(np.abs(rest)) < 1e-12 * np.max(E)


@pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
def test_the_energy_of_moreau_jean_and_bilbao(e):
    system, _ = chain(2, e=e)
    dt = 0.02
    run, q, v, R, _ = steps_of(system, sb.MoreauJeanBilbao(), dt, 400)
    basis = sb.modes(system)
    shapes = basis.shapes / np.sqrt(np.sum(basis.shapes * (system.mass @ basis.shapes), axis=0))
    x, y = (np.linalg.solve(shapes, z[1:].T).T for z in (q, v))
    w = basis.omega
    phi = 4.0 * np.sin(0.5 * w * dt) ** 2 / (w * dt) ** 2
    E = 0.5 * np.sum(y**2 / phi + (w * x) ** 2 - dt * y * w**2 * x, axis=1)
    mean = 0.5 * (v[2:] + v[1:-1])
    B = np.array([c.row for c in system.contacts])
    work = dt * np.sum((system.load(run.t)[1:-1] + R[1:] @ B) * mean, axis=1)
    assert np.max(np.abs(np.diff(E) - work)) < 1e-12 * np.max(E)


def test_moreau_and_jean_lose_what_newtons_law_takes_and_nothing_else():
    system, _ = chain(2, moving=True, e=0.4)
    still, _ = chain(2, e=0.4)
    E = sb.integrate(still, sb.MoreauJean(), 0.01, 5.0).energy
    assert abs(E.loss[-1]) < 1e-12 * np.max(E.energy)
    assert E.stop_dissipation[-1] > 0.1 * np.max(E.energy)
    moved = sb.integrate(system, sb.MoreauJean(), 0.001, 5.0).energy  # the stop's work is a sum over steps
    assert abs(moved.loss[-1]) < 1e-2 * np.max(moved.energy)
    assert np.all(sb.integrate(chain(2)[0], sb.BDF2(), 0.01, 5.0).energy.stop_dissipation == 0.0)
