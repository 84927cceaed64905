"""The page of the test set: reference/problems/README.md and one picture a problem."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from stiffbeam.figures.chart import COLOURS, Axes, new_figure
from stiffbeam.testset.problem import VERSION, Answer, Problem, read

LONG = 6  # values that a page shows of a list


def write_page(folder: Path) -> None:
    """Pictures beside the files, and the page that shows them."""
    made = sorted((read(x.read_text(encoding="utf-8")) for x in folder.glob("*.toml")), key=lambda p: p.number)
    for problem in made:
        figure = new_figure(2.6, width=8.0)
        motion(axis := figure.subplots(), problem)
        figure.legend(*axis.get_legend_handles_labels(), loc="outside upper right", fontsize=8, frameon=False, ncols=3)
        figure.savefig(folder / f"{problem.name}.png", dpi=80)
    (folder / "README.md").write_text(page_text(made), encoding="utf-8")


def motion(axis: Axes, problem: Problem) -> None:
    """The known tip positions with the stops of the first contact, and the known impacts."""
    contact = problem.data["contacts"][0]
    t, u, v = problem.times, problem.answers["tip"].value, problem.answers["tip_velocity"].value
    # Impacts on rigid stops turn the velocity between samples, where a cubic would not.
    if "impacts" not in problem.answers or not problem.system.rigid:
        fine = np.linspace(t[0], t[-1], 1500)
        axis.plot(fine, CubicHermiteSpline(t, u, v)(fine), color="black", lw=1.0)
    axis.plot(t, u, "o", color="black", ms=2.5, label="known")
    if problem.data.get("observe", contact["row"]) == contact["row"] and "offset" not in contact:
        sides = [side for side in ("lower", "upper") if side in contact]
        for side in sides:
            axis.axhline(contact[side], color=COLOURS[1], lw=1.0, label="stop" if side == sides[0] else None)
    if "impacts" in problem.answers:
        when = problem.answers["impacts"].value
        axis.plot(when, np.full(len(when), 0.02), "|", color=COLOURS[1], ms=9, transform=axis.get_xaxis_transform(),
                  label="impacts")  # fmt: skip
    axis.set(xlabel="time $t$", ylabel="$u(t)$")


def page_text(made: list[Problem]) -> str:
    """The page in Markdown."""
    lines = [HEAD.format(version=VERSION, count=len(made))]
    lines += ["| problem | unknowns | what it is |", "|---|---|---|"]
    for p in made:
        size = len(p.data["initial_displacement"])
        lines.append(f"| [{p.name}](#{p.name}) | {size} | {p.title}{', rigid stop' if p.system.rigid else ''} |")
    for p in made:
        lines += ["", f"## {p.name}", "", f"{p.title}. **Tests:** {p.catches}", ""]
        lines += [f"![The motion of {p.name}]({p.name}.png)", ""]
        lines += [f"Source: {p.source}. Data and all answers: [{p.name}.toml]({p.name}.toml).", ""]
        lines += ["| answer | value | how |", "|---|---|---|"]
        for name, answer in p.answers.items():
            if name not in ("tip_velocity", "energy_scale"):
                lines.append(f"| {_label(name, p)} | {_value(answer)} | {answer.how.replace('|', chr(92) + '|')} |")
        if p.derivatives:
            tips, velocities = p.derivatives["tip"], p.derivatives["tip_velocity"]
            lines += [
                "",
                f"| derivative at t = {p.t_end:g} with respect to | of the tip | of its velocity |",
                "|---|---|---|",
            ]
            lines += [f"| `{path}` | {tips[path].digits} | {velocities[path].digits} |" for path in tips]
    return "\n".join(lines) + TAIL


def _label(name: str, problem: Problem) -> str:
    return f"tip at t = {problem.t_end:g}" if name == "tip" else name.replace("_", " ")


def _value(answer: Answer) -> str:
    if isinstance(answer.digits, str):
        return answer.digits
    values = np.array(answer.digits)
    shown = values[-1:] if len(values) > 24 else values[:LONG]
    text = "<br>".join(shown)
    return text if len(values) > 24 or len(values) <= LONG else f"{text}<br>… {len(values)} in the file"


HEAD = """# Problems with known answers, version {version}

{count} vibro-impact problems whose answers are known to 30 digits. They are plain data for programs in any language.
Each is one TOML file with matrices, contact law, loads, initial data and answers. Numbers are the doubles that a TOML
reader returns. The answers are decimals in quotes, computed for exactly these doubles.

    M q'' + C q' + K q = sum of vector f(t) + sum of row^T F(row q + offset(t))

* `mass`, `damping` and `stiffness` are symmetric matrices, given as rows or as `bands`: the diagonal, then the next
  diagonal and so on.
* A load is a `vector` times a function of time. The function is `constant`, or
  `amplitude` sin(`frequency` t + `phase`), or straight lines between `values` at `times`.
* A contact acts if `row` q + `offset` passes `upper` upwards or `lower` downwards by d > 0. The force against it is
  (`stiffness` d^`exponent` (1 + `dissipation` d') + `damping` d')₊.
* `stiffness = inf` is a rigid stop with Newton's `restitution`.
* `observe` is the row of the tip u; by default it is the row of the first contact.
* `tip` and `tip_velocity` are given at the times k `t_end`/`samples`, k = 1, 2, …, rounded to doubles.
* `derivatives` of `tip` and `tip_velocity` at `t_end` are known for nine problems, by the path of a parameter.
* `impacts` and `releases` are the event times of the first contact. A contact that is closed at the start does not
  count as an impact.

## Score your integrator

In Python, write a function of the system, the time step and the end time. It runs with a fixed step and returns times
and tip, or times, positions and velocities of all unknowns. The system has `.mass`, `.damping`, `.stiffness`, `.q0`,
`.v0`, `.load(t)`, `.contacts[i].row` and `.contacts[i].stops`. If the position at a contact is not row q alone, it also
has `.contacts[i].offset`. For example:

```python
import numpy as np
import stiffbeam as sb


def central_differences(system, dt, t_end):
    t = np.arange(round(t_end / dt) + 1) * dt
    inverse, q, v = np.linalg.inv(system.mass), system.q0, system.v0

    def acceleration(t, q, v):
        forces = system.load(t) - system.damping @ v - system.stiffness @ q
        for c in system.contacts:
            moved, rate = (0.0, 0.0) if c.offset is None else (c.offset.value(t), c.offset.rate(t))
            forces = forces + c.row * c.stops.force(c.row @ q + moved, c.row @ v + rate)
        return inverse @ forces

    positions, velocities = [q], [v]
    for k in range(len(t) - 1):
        now = acceleration(t[k], q, v)
        q = q + dt * (v + 0.5 * dt * now)
        v = v + 0.5 * dt * (now + acceleration(t[k + 1], q, v + dt * now))
        positions.append(q)
        velocities.append(v)
    return t, np.array(positions), np.array(velocities)


problems = ["free-oscillator", "bilinear-oscillator", "bilinear-gap", "two-mass-chain"]
print(sb.score(central_differences, problems))
```

Any other program writes a CSV file with the columns t, u and, if available, v, with equal steps up to `t_end`. Several
files with different steps also give an order:

    stiffbeam score --trajectory ball.csv --problem bouncing-ball
    stiffbeam score mymodule:solve                           a function as above, in mymodule.py

The score contains the errors

* of the tip at the sample times, as rms relative to its largest value, and of its velocity;
* of the impact times;
* of the peak force, interpolated between the steps by cubics;
* of the energy at the end.

The score flags an integrator on a problem, with the reason in one sentence, in these cases:

* an error does not fall with the step;
* the order of the tip, or of the velocity of one or two masses, is lower by more than a half than its order on
  `free-oscillator` and the kink or jump of the law allow;
* the finest run lacks one of the first eight impacts;
* the integrator raises an error.

If coarse steps overflow or the finest run lacks an impact, shorter steps are added.

| command or fixture | result |
|---|---|
| `stiffbeam score` | scores of this package's schemes and solvers, in less than a minute |
| `--out DIR` | table, records and pictures |
| `--json FILE` | records |
| a [test](../../studies/tutorial/references_in_tests.md) with `known_problem` | runs once for every problem |

"""

TAIL = """
## How the answers are made, and changed

`python studies/test_set/make.py` makes every file, every picture and this page. The answers come from

* closed forms and quadratures in mpmath with 60 digits;
* for piecewise-linear systems, the multiprecision solution of stiffbeam (python-flint), computed twice with different
  precision.

The derivatives come from differences of order 8 of these answers. When they were frozen, Taylor series with variational
equations in MPFR (heyoka) gave the same 22 digits.

`tests/testset/test_known_answers.py` checks the answers with methods that share no code with the first solution: matrix
exponentials between events, in mpmath if the system is small, and Runge-Kutta of order 8 with events.

Continuum values are marked as such. Cite the test set by its version, see [`CITATION.cff`](../../CITATION.cff).

| version | change |
|---|---|
| 1.0 | first |
| 2.0 | hertz, hunt-crossley: the velocity at the first touch is 1, not 1.00018; changes in the 25th digits |
| 3.0 | event times and peak forces of the piecewise-linear problems: changes in up to three of the last of 30 digits |
| 3.1 | derivatives of nine problems |
| 3.2 | one problem more: damped-chain |
| 3.3 | one problem more: moving-dashpot |
| 3.4 | without statistics past the horizon |
"""
