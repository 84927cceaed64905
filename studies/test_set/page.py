"""The page of the test set: reference/problems/README.md and one picture a problem."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stiffbeam.testset.pictures import problem_picture
from stiffbeam.testset.problem import VERSION, Answer, Problem, read

LONG = 6  # values that a page shows of a list


def write_page(folder: Path) -> None:
    """Pictures beside the files, and the page that shows them."""
    made = sorted((read(x.read_text(encoding="utf-8")) for x in folder.glob("*.toml")), key=lambda p: p.number)
    for problem in made:
        problem_picture(problem).savefig(folder / f"{problem.name}.png", dpi=80)
    (folder / "README.md").write_text(page_text(made), encoding="utf-8")


def page_text(made: list[Problem]) -> str:
    """The page in Markdown."""
    lines = [HEAD.format(version=VERSION, count=len(made))]
    lines += ["| problem | unknowns | what it is |", "|---|---|---|"]
    for p in made:
        size = len(p.data["initial_displacement"])
        lines.append(f"| [{p.name}](#{p.name}) | {size} | {p.title}{', rigid stop' if p.rigid else ''} |")
    for p in made:
        lines += ["", f"## {p.name}", "", f"{p.title}. {p.catches}", ""]
        lines += [f"![The motion of {p.name}]({p.name}.png)", ""]
        lines += [f"Source: {p.source}. Data and all answers: [{p.name}.toml]({p.name}.toml).", ""]
        lines += ["| answer | value | how |", "|---|---|---|"]
        for name, answer in p.answers.items():
            if name not in ("tip_velocity", "energy_scale"):
                lines.append(f"| {_label(name, p)} | {_value(answer)} | {answer.how.replace('|', chr(92) + '|')} |")
        if p.statistics is not None:
            s = p.statistics
            values = (f"{n.replace('_', ' ')} {m:.4g} ± {d:.2g}" for n, (m, d) in s.values.items())
            lines += ["", f"Past the horizon, to t = {s.t_end:g}: {', '.join(values)}, mean ± standard deviation of "
                      f"{s.members} exact motions whose initial data differ by {s.size:g}."]  # fmt: skip
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

{count} vibro-impact problems whose answers are known to 30 digits, as plain data for programs in any language: one TOML
file each, with matrices, contact law, loads, initial data and answers. Numbers are the doubles that a TOML reader
gives; the answers, decimals in quotes, are those of these doubles.

    M q'' + C q' + K q = sum of vector f(t) + sum of row^T F(row q + offset(t))

`mass`, `damping` and `stiffness` are rows, or `bands`: the diagonal, then the one beside it and so on, all symmetric. A
load is a `vector` times `constant`, or `amplitude` sin(`frequency` t + `phase`), or straight lines between `values` at
`times`. A contact acts where `row` q + `offset` passes `upper` upwards or `lower` downwards by d > 0, with the force
(`stiffness` d^`exponent` (1 + `dissipation` d') + `damping` d')₊ against it; `stiffness = inf` is a rigid stop with
Newton's `restitution`. `observe` is the row of the tip u, the first contact's where it is left out. `tip` and
`tip_velocity` are known at the times k `t_end`/`samples`, k = 1, 2, …, rounded to doubles; `impacts` and `releases` of
the first contact by events, a contact that is there at the start is none.

## Score your integrator

In Python, a function of the system (`.mass`, `.damping`, `.stiffness`, `.q0`, `.v0`, `.load(t)`, `.contacts[i].row`,
`.contacts[i].stops` and, where what a contact sees is not row q alone, `.contacts[i].offset`) with a fixed step, that
returns times and tip, or times, positions and velocities of all unknowns:

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
        half = v + 0.5 * dt * acceleration(t[k], q, v)
        q = q + dt * half
        v = half + 0.5 * dt * acceleration(t[k + 1], q, half)
        positions.append(q)
        velocities.append(v)
    return t, np.array(positions), np.array(velocities)


problems = ["free-oscillator", "bilinear-oscillator", "bilinear-gap", "two-mass-chain", "stop-along-the-beam"]
print(sb.score(central_differences, problems))
```

Any other program writes a CSV file with the columns t, u and, if it knows it, v, with equal steps to `t_end`; several
files with different steps have an order:

    stiffbeam score --list                                   the problems
    stiffbeam score --list --problem bouncing-ball           the file of one
    stiffbeam score --trajectory ball.csv --problem bouncing-ball
    stiffbeam score mymodule:solve                           a function as above, in mymodule.py

The errors are those of the tip at the sample times over its largest size (rms), of the impact times, of the peak force,
taken between the steps by cubics, and of the energy at the end. An integrator is flagged where its error does not fall
as the step does, or more slowly than its order on `free-oscillator` and the kink or jump of the law allow, and where
its velocity is not the rate of its tip; where a file has too few digits to tell, the card says so. `stiffbeam score`
alone scores this package's schemes and solvers in less than a minute; `--out DIR` writes a page with pictures,
`--json FILE` records, and `--latex --problem NAME` a table for a paper. A test that takes `known_problem`, of the
package's pytest plugin, runs once for every problem.

"""

TAIL = """
## How the answers are made, and changed

`python studies/test_set/make.py` makes every file, picture and this page: closed forms and quadratures in mpmath with
60 digits, and for piecewise-linear systems the multiprecision solution of stiffbeam (python-flint), twice with
different precision. `tests/testset/test_known_answers.py` holds each against a second way that shares no code with the
first: matrix exponentials between switches, in mpmath where the system is small, and Runge-Kutta of order 8 with
events; `tests/testset/test_known_answers_by_series.py` every digit of the piecewise-linear ones against Taylor series
in whole numbers.
Continuum values are marked as such. Cite the test set by its version, see [`CITATION.cff`](../../CITATION.cff).

| version | change of answers |
|---|---|
| 1.0 | first |
| 2.0 | hertz, hunt-crossley: the velocity at the first touch, 1 and not 1.00018; their 25th digits |
| 3.0 | times of switches and peak forces of the piecewise-linear problems: up to three of the last of 30 digits |
"""
