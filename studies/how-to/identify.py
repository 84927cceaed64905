"""Identify the stiffness of a stop and its gap from a record, through the exact motion and through schemes.

    python studies/how-to/identify.py --out FOLDER [--windows 0.053 0.06 0.08] [--noise 1e-3]

The beam of Table 10 moves against its stops. A record of its tip with noise is made from the exact solution. The script
starts from a stiffness 20 % and a gap 2 % off and fits both to growing windows of the record, with one, five and seven
impacts. A motion with impacts depends so strongly on its parameters that only a short window leads to the right
minimum; the last one has to end before the horizon. ``sb.jax_flow`` gives the values and their exact derivative.

The script then fits schemes at the paper's step to the same record. Their derivative is wrong, so the script
searches a grid around the true values. The best stiffness is off by far more than its standard deviation. The
script takes half a minute.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares, minimize

import stiffbeam as sb
from stiffbeam.figures.chart import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PATHS = ("stops.stiffness", "stops.upper")
NAMES = ("stiffness", "gap")
START = (0.8, 1.02)  # factors on the true values
SAMPLE = 2e-4  # between two entries of the record
SIMPLEX = ((0.0, 0.0), (0.05, 0.0), (0.0, 1e-3))
DIFFERENCE = 1e-3
SCHEMES = {
    "trapezoidal": (sb.Trapezoidal(), "implicit"),
    "HHT": (sb.HHT(alpha=-0.1), "implicit"),
    "BDF2": (sb.BDF2(), "implicit"),
    "exponential, conserving": (sb.ExponentialFlow(), "conserving"),
}

Array = NDArray[np.float64]


@dataclass
class Estimate:
    """Estimated factors on the true parameters, with their standard deviations, and the misfit over the noise."""

    factors: Array
    deviations: Array
    misfit: float
    tip: Array


def through_the_exact_motion(
    system: sb.System, windows: list[float], t: Array, data: Array, noise: float
) -> tuple[Estimate, list[Array]]:
    """Least squares through ``sb.jax_flow`` in the logarithms of the factors, and where every window leads."""
    way, result = [np.array(START)], OptimizeResult()
    for end in windows:
        flow = sb.jax_flow(system, PATHS, t[t <= end])
        record = data[: len(flow.t)]

        def residuals(x: Array, flow: sb.JaxFlow = flow, record: Array = record) -> jax.Array:
            return (flow(jnp.exp(x) * flow.start) - record) / noise

        slopes = jax.jit(jax.jacfwd(residuals))
        result = least_squares(jax.jit(residuals), np.log(way[-1]), slopes, x_scale="jac")  # pyright: ignore[reportArgumentType]
        way.append(np.exp(result.x))
    covariance = np.linalg.inv(result.jac.T @ result.jac)
    deviations = way[-1] * np.sqrt(np.diag(covariance))
    return Estimate(way[-1], deviations, float(np.sqrt(np.mean(result.fun**2))), noise * result.fun + data), way


def through_a_scheme(
    system: sb.System, scheme: sb.Scheme, contact: str, dt: float, t: Array, data: Array, noise: float, grid: int
) -> Estimate:
    """The best fit of a scheme's own motion at a step: on a grid, then by a simplex, as its derivative is a false one.

    Standard deviations from differences of a thousandth, which average over the steps at which contacts change.
    """
    every = round(SAMPLE / dt)
    truth = np.array([sb.jax_flow(system, PATHS, t[:2]).start]).ravel()

    def tip(x: Array) -> Array:
        values = dict(zip(PATHS, np.exp(x) * truth, strict=True))
        moved = sb.varied_members(system, {path: [value] for path, value in values.items()})[0]
        return sb.integrate(moved, scheme, dt, float(t[-1]), contact=contact, every=every).tip[1:]

    def misfit(x: Array) -> float:
        return float(np.sqrt(np.mean(((tip(x) - data) / noise) ** 2)))

    stiffnesses, gaps = np.linspace(-1.5, 1.5, grid), np.linspace(-0.01, 0.01, grid // 3 + 1)
    best = min((np.array([a, b]) for a in stiffnesses for b in gaps), key=misfit)
    x = minimize(misfit, best, method="Nelder-Mead", options={"initial_simplex": np.add(best, SIMPLEX)}).x
    slopes = np.column_stack([(tip(x + h) - tip(x - h)) / (2.0 * DIFFERENCE * noise) for h in DIFFERENCE * np.eye(2)])
    deviations = np.exp(x) * np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))
    return Estimate(np.exp(x), deviations, misfit(x), tip(x))


def picture(t: Array, data: Array, estimates: dict[str, Estimate], dt: float) -> Figure:
    """The record with two fits, and the stiffness that every method reports, with its 95 % interval."""
    exact = estimates["exact motion"]
    worst = max(estimates, key=lambda name: abs(estimates[name].factors[0] - 1.0))
    off, right = (estimates[name].factors[0] - 1.0 for name in (worst, "exact motion"))
    way = "stiff" if off > 0 else "soft"
    title = f"A stop identified by {worst} at dt = {dt:g} is {abs(off):.0%} too {way}, by the exact motion {right:+.1%}"
    figure = new_figure(4.2, title, 9.6)
    record, stiffness = figure.subplots(1, 2)
    record.plot(t, data, ".", ms=3, color="0.6", label="record")
    record.plot(t, exact.tip, color="black", lw=1.0, label="exact motion, fitted")
    record.plot(t, estimates[worst].tip, color="#d55e00", lw=1.0, ls="--", label=f"{worst}, fitted")
    record.set(xlabel="time", ylabel="tip", xlim=(0.6 * t[-1], t[-1]), ylim=(0.6 * max(data), 1.05 * max(data)))
    record.legend(fontsize=8)
    for k, (name, estimate) in enumerate(estimates.items()):
        color = "black" if name == "exact motion" else "#0072b2"
        stiffness.errorbar(100.0 * (estimate.factors[0] - 1.0), -k, xerr=196.0 * estimate.deviations[0], fmt="o",
                           ms=4, capsize=3, color=color)  # fmt: skip
    stiffness.axvline(0.0, color="0.6", lw=0.8)
    stiffness.set(xlabel="error of the stiffness, % (95 % interval)")
    stiffness.set_yticks([-k for k in range(len(estimates))], list(estimates))
    return figure


def main() -> None:
    """Make the record, fit it, print the table and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cells", type=int, default=10)
    parser.add_argument("--windows", type=float, nargs="+", default=[0.053, 0.06, 0.08])
    parser.add_argument("--noise", type=float, default=1e-3, help="standard deviation over the largest tip")
    parser.add_argument("--grid", type=int, default=61, help="stiffnesses at which the search for a scheme begins")
    chosen = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    case = sb.paper_case(10)
    assert isinstance(case.problem, sb.BeamProblem)
    system = sb.semidiscretise(case.problem, cells=chosen.cells)
    end = chosen.windows[-1]
    t = np.linspace(0.0, end, round(end / SAMPLE) + 1)[1:]
    exact = sb.reference(system, end, t_eval=t)
    noise = chosen.noise * float(np.max(np.abs(exact.tip)))
    data = exact.tip + noise * np.random.default_rng(1).standard_normal(len(t))
    estimate, way = through_the_exact_motion(system, chosen.windows, t, data, noise)
    print("windows lead to", *(f"stiffness {x[0]:.4f}, gap {x[1]:.6f};" for x in way))
    estimates = {"exact motion": estimate}
    for name, (scheme, contact) in SCHEMES.items():
        estimates[name] = through_a_scheme(system, scheme, contact, case.dt, t, data, noise, chosen.grid)
    print(
        f"{'method':<26}"
        + "".join(f"{name + ' off, %':>16}{'sigma, %':>10}" for name in NAMES)
        + f"{'misfit/noise':>14}"
    )
    for name, each in estimates.items():
        cells = "".join(
            f"{100.0 * (x - 1.0):>16.3g}{100.0 * s:>10.2g}" for x, s in zip(each.factors, each.deviations, strict=True)
        )
        print(f"{name:<26}{cells}{each.misfit:>14.1f}")
    chosen.out.mkdir(parents=True, exist_ok=True)
    picture(t, data, estimates, case.dt).savefig(chosen.out / "identify.png", dpi=150)


if __name__ == "__main__":
    main()
