"""How fast is a step, a run and a reference beside what others offer, in one process and as ratios?

    python studies/peers.py [--quick] [--out FILE]

Table 10, M = 25. A step of HHT-alpha by the block march against the same scheme written by hand: in C (compiled at
run time where there is a compiler), in numba in modes and with banded matrices, as a JAX scan and as a NumPy loop with
a prefactored LU. A reference to t = 0.1 at rtol 1e-9: the exact solution against CVODE Adams and DOP853 with the
package's compiled right-hand side, both with one in NumPy, and diffrax' Dopri8. Everything takes turns and counts in
processor time, the least of several; compilation is left out. What is not installed is named and left out. The
programs of a step have to agree to 1e-9 before chaos, and every reference says how far it is from the exact one.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from hand_written import banded, by_hand, in_c, jax_scan, numpy_loop
from timing import least, timed

import stiffbeam as sb
from stiffbeam.march.block_march import March
from stiffbeam.march.integrate import Plan

ALPHA, RTOL, T_END = -0.1, 1e-9, 0.1
STEPPERS = {
    "C by hand, in modes": in_c,
    "numba by hand, in modes": partial(by_hand, clock=time.process_time),
    "numba by hand, banded": banded,
    "JAX scan, in modes": jax_scan,
    "NumPy loop": numpy_loop,
}
SLOW = 2000  # steps of what takes microseconds each


def steps(system: sb.System, dt: float, count: int, repetitions: int) -> tuple[dict[str, float], list[str]]:
    """ns per step of every program, and what is missing."""
    plan, runs, counts, missing = Plan.of(system, sb.HHT(ALPHA), dt, count * dt, "implicit", 1, "numba"), {}, {}, []
    assert plan.stepper is not None
    tip = sb.integrate(system, sb.HHT(ALPHA), dt, 0.05).tip

    def march(stepper=plan.stepper) -> None:
        for _ in March(stepper, (system,), count, None).advance():
            pass

    for name, make in STEPPERS.items():
        counts[name] = min(count, SLOW) if make is numpy_loop else count
        try:
            runs[name], made = make(system, dt, counts[name])
        except (ImportError, OSError) as error:
            missing.append(f"{name} ({error})")
            continue
        runs[name]()
        assert np.max(np.abs(made[: len(tip)] - tip)) < 1e-9, f"{name} marches another scheme"
    runs["stiffbeam, block march with impacts and peaks"] = timed(march)
    runs["stiffbeam, integrate with every step kept"] = timed(
        lambda: sb.integrate(system, sb.HHT(ALPHA), dt, count * dt)
    )
    found = least(runs, repetitions)
    return {name: 1e9 * x / counts.get(name, count) for name, x in found.items()}, missing


def references(system: sb.System, repetitions: int) -> tuple[dict[str, float], dict[str, float], list[str]]:
    """Seconds of every solver, its largest error over that of the tip, and what is missing."""
    t = np.linspace(0.0, T_END, 101)
    exact = sb.reference(system, T_END, t_eval=t).tip
    ours = {"exact": "exact", "CVODE Adams, compiled": "cvode-adams", "DOP853, compiled": "dop853"}
    solvers: dict[str, Callable[[], np.ndarray]] = {
        name: lambda method=method: _solved(system, t, method) for name, method in ours.items()
    }
    missing = []
    for name, (module, solve) in OTHERS.items():
        try:
            import_module(module)
        except ImportError:
            missing.append(f"{name} ({module} is not installed)")
            continue
        solvers[name] = solve(system, t)
    errors = {name: float(np.max(np.abs(solve() - exact)) / np.max(np.abs(exact))) for name, solve in solvers.items()}
    return least({name: timed(solve) for name, solve in solvers.items()}, repetitions), errors, missing


def _solved(system: sb.System, t: np.ndarray, method: str) -> np.ndarray:
    from stiffbeam.references import solve

    return solve(system, T_END, method, t, RTOL, 1e-12).tip


def _right(system: sb.System) -> Callable[[float, np.ndarray], np.ndarray]:
    """y' for y = (q, q') in NumPy, as one writes it."""
    inverse, n, contact = np.linalg.inv(system.mass), system.size, system.contacts[0]
    stiffness, column, stops = inverse @ system.stiffness, inverse @ contact.row, contact.stops
    loads: list[Any] = [(inverse @ vector, function) for vector, function in system.loads]

    def right(t: float, y: np.ndarray) -> np.ndarray:
        u = contact.row @ y[:n]
        rate = column * (stops.stiffness * (min(max(u, stops.g1), stops.g2) - u)) - stiffness @ y[:n]
        for vector, function in loads:
            rate = rate + vector * float(function.value(t))
        return np.concatenate([y[n:], rate])

    return right


def _scipy(system: sb.System, t: np.ndarray) -> Callable[[], np.ndarray]:
    from scipy.integrate import solve_ivp

    right, y0 = _right(system), np.concatenate([system.q0, system.v0])
    return lambda: system.contacts[0].row @ solve_ivp(
        right, (0.0, T_END), y0, "DOP853", t, rtol=RTOL, atol=1e-12
    ).y[: system.size]  # fmt: skip


def _cvode(system: sb.System, t: np.ndarray) -> Callable[[], np.ndarray]:
    from sksundae.cvode import CVODE

    right, y0 = _right(system), np.concatenate([system.q0, system.v0])

    def rates(at: float, y: np.ndarray, rate: np.ndarray) -> None:
        rate[:] = right(at, y)

    def solve() -> np.ndarray:
        solver = CVODE(rates, method="Adams", rtol=RTOL, atol=1e-12, max_num_steps=10**6)
        return np.asarray(solver.solve(t, y0).y)[:, : system.size] @ system.contacts[0].row

    return solve


def _diffrax(system: sb.System, t: np.ndarray) -> Callable[[], np.ndarray]:
    import diffrax
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    inverse, n, contact = jnp.linalg.inv(jnp.array(system.mass)), system.size, system.contacts[0]
    stiffness, row = inverse @ system.stiffness, jnp.array(contact.row)
    loads: list[Any] = [(inverse @ vector, f) for vector, f in system.loads]

    def field(at, y, _):
        u = row @ y[:n]
        rate = inverse @ row * contact.stops.force_in(jnp, u) - stiffness @ y[:n]
        for vector, f in loads:
            rate = rate + vector * (f.sine * jnp.sin(f.frequency * at) + f.cosine * jnp.cos(f.frequency * at))
        return jnp.concatenate([y[n:], rate])

    @jax.jit
    def run(y0):
        control = diffrax.PIDController(rtol=RTOL, atol=1e-12)
        return diffrax.diffeqsolve(
            diffrax.ODETerm(field), diffrax.Dopri8(), 0.0, T_END, None, y0, saveat=diffrax.SaveAt(ts=jnp.array(t)),
            stepsize_controller=control, max_steps=2_000_000,
        ).ys[:, :n] @ row  # type: ignore[index]  # fmt: skip

    start = jnp.concatenate([jnp.array(system.q0), jnp.array(system.v0)])
    return lambda: np.asarray(run(start))


OTHERS = {
    "CVODE Adams, right-hand side in NumPy": ("sksundae", _cvode),
    "DOP853, right-hand side in NumPy": ("scipy", _scipy),
    "diffrax Dopri8": ("diffrax", _diffrax),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a smoke run: few repetitions")
    parser.add_argument("--out", type=Path, default=Path("stiffbeam-output/peers.json"))
    options = parser.parse_args()
    case, begun = sb.paper_case(10), time.time()
    system = sb.semidiscretise(case.problem, case.cells)
    ns, missing = steps(system, case.dt, 20_000, 2 if options.quick else 9)
    seconds, errors, also = references(system, 1 if options.quick else 3)
    unit = next(name for name in STEPPERS if name in ns)
    print(f"A step of HHT, {ns[unit]:.0f} ns {unit}, as a multiple of that:")
    for name, x in ns.items():
        print(f"  {name:46}{x / ns[unit]:10.3g}")
    print(f"A solution to t = {T_END}, {1e3 * seconds['exact']:.3g} ms exact, as a multiple of that, and its error:")
    for name, x in seconds.items():
        print(f"  {name:46}{x / seconds['exact']:10.3g}{errors[name]:10.1e}")
    for name in missing + also:
        print(f"Not measured: {name}")
    ratios = {f"{k} / {unit}": v / ns[unit] for k, v in ns.items()}
    ratios |= {f"{k} / exact": v / seconds["exact"] for k, v in seconds.items()}
    record = {"ns": ns, "seconds": seconds, "errors": errors, "missing": missing + also, "ratios": ratios}
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    print(f"{time.time() - begun:.0f} s; written to {options.out}")


if __name__ == "__main__":
    main()
