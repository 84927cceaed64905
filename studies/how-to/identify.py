"""Identify the stiffness of a stop and its gap from a record, through the exact motion and through schemes.

    python studies/how-to/identify.py

The beam of Table 10 moves against its stops. A record of its tip, with noise, is made from the exact solution. The
script starts from a stiffness 20 % and a gap 2 % off and fits both to growing windows, with one, five and seven
impacts: only a short window leads from there to the right minimum, and the last one has to end before the horizon.
``sb.jax_flow`` gives values and derivatives. The derivatives of a scheme are wrong, so each scheme, at the paper's
step, is fitted by a search on a grid and a simplex. Its best stiffness is off by more than the noise explains.
"""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares, minimize

import stiffbeam as sb

PATHS, WINDOWS = ("stops.stiffness", "stops.upper"), (0.053, 0.06, 0.08)
SAMPLE, NOISE, GRID = 2e-4, 1e-3, 31  # between entries of the record; over the largest tip; stiffnesses of the grid

if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    system = sb.semidiscretise(sb.paper_case(10).problem, cells=10)
    t = np.linspace(0.0, WINDOWS[-1], round(WINDOWS[-1] / SAMPLE) + 1)[1:]
    exact = sb.reference(system, WINDOWS[-1], t_eval=t)
    noise = NOISE * np.max(np.abs(exact.tip))
    data = exact.tip + noise * np.random.default_rng(1).standard_normal(len(t))

    x = np.log([0.8, 1.02])  # logarithms of the factors on the true values
    for end in WINDOWS:
        flow = sb.jax_flow(system, PATHS, t[t <= end])
        residuals = jax.jit(lambda x, flow=flow: (flow(jnp.exp(x) * flow.start) - data[: len(flow.t)]) / noise)
        fit = least_squares(residuals, x, jax.jit(jax.jacfwd(residuals)), x_scale="jac")
        x = fit.x
        print(f"to t = {end}: stiffness {np.exp(x[0]) - 1:+.2%}, gap {np.exp(x[1]) - 1:+.3%}")
    deviations = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)))
    print(f"standard deviations {deviations[0]:.2%}, {deviations[1]:.3%}")
    assert np.all(np.abs(x) < 3.0 * deviations)
    assert deviations[0] < 0.02

    for scheme in (sb.HHT(alpha=-0.1), sb.BDF2()):

        def misfit(x, scheme=scheme):
            values = {path: [value] for path, value in zip(PATHS, np.exp(x) * flow.start, strict=True)}
            moved = sb.varied_members(system, values)[0]
            tip = sb.integrate(moved, scheme, 1e-4, t[-1], every=round(SAMPLE / 1e-4)).tip[1:]
            return np.sqrt(np.mean(((tip - data) / noise) ** 2))

        grid = [(a, b) for a in np.linspace(-1.5, 1.5, GRID) for b in np.linspace(-0.01, 0.01, GRID // 3 + 1)]
        simplex = np.add(min(grid, key=misfit), [(0.0, 0.0), (0.05, 0.0), (0.0, 1e-3)])
        fit = minimize(misfit, simplex[0], method="Nelder-Mead", options={"initial_simplex": simplex})
        print(f"{scheme}: stiffness {np.exp(fit.x[0]) - 1:+.0%}, misfit {fit.fun:.1f} times the noise")
