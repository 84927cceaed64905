# ruff: noqa: E501
"""Planted faults: each is a replacement in a copy of the sources; the tests of its room have to fail.

    python tests/campaigns/planted_faults.py [--root CHECKOUT] [--only NUMBER,...] [--room ROOM] [--slow]

``--root``: the checkout whose tests run, by default this one; its sources are copied, its tests are not. One line is
printed for each fault: "caught" with the first test that fails, or "MISSED". Exit status 1 where one is missed.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

# Room, file under src/stiffbeam, what stands there (once) and what is put in its place.
FAULTS = [
    # kernels: the march in blocks
    ("march", "kernels/march.c", "x->before[c] = pushed(s, f, first, i + m, i + c)",
     "x->before[c] = pushed(s, f, first, i, i + c)"),
    ("march", "kernels/march.c", "for (int e = 0; e < i; e++) r += force[e]", "for (int e = 1; e < i; e++) r += force[e]"),
    ("march", "march/block_march.py", "law, (u, v) = laws(member.contacts)", "law, (u, v) = laws(self.system.contacts)"),
    ("march", "march/block_march.py", "own or functions(system) == functions(stepper.system)", "True"),
    ("march", "kernels/march.c", "drive_at(drive, (double)at * run->dt, g)", "drive_at(drive, (double)(at + 1) * run->dt, g)"),
    ("march", "kernels/march.c", "Int first_output(const Run *r, Int at) { return r->every - 1 - at % r->every; }",
     "Int first_output(const Run *r, Int at) { (void)at; return r->every - 1; }"),
    ("march", "kernels/march.c", "3.0 * slope - 2.0 * rate0 - rate1", "3.0 * slope - rate0 - 2.0 * rate1"),
    ("march", "kernels/march.c", "double stop = side > 0.0 ? l->g2 : l->g1, sign", "double stop = side < 0.0 ? l->g2 : l->g1, sign"),
    ("march", "kernels/march.c", "if (k < passed ||", "if (k <= passed ||"),
    ("march", "kernels/march.c", "peak = most(peak, size), touching", "peak = size, touching"),
    ("march", "kernels/march.c", "open[IMPACT_IMPULSE] += fabs(node_force[k]) * dt;", ";"),
    ("march", "kernels/march.c", "e[column] = ((double)(at + k) + inside) * run->dt", "e[column] = ((double)(at + k + 1) + inside) * run->dt"),
    ("march", "kernels/march.c", "speed(s, block - 1, b->K - 1, c)", "speed(s, block - 1, 0, c)"),
    ("march", "kernels/march.c", "memcpy(z + D, z, (size_t)((b->a - 1)", "memcpy(z + D, z, (size_t)((b->a > 3 ? 0 : b->a - 1)"),
    ("march", "kernels/march.c", "block < blocks && !*run->diverged;", "block < blocks;"),
    # kernels: the law
    ("march", "kernels/law.h", "u < l->g1 ? u - l->g1 : 0.0; }", "u < l->g1 ? u + l->g1 : 0.0; }"),
    ("model", "kernels/law.h", "-side * most(0.0, pressure(fabs(depth(u, l)), side * v, l));", "-side * pressure(fabs(depth(u, l)), side * v, l);"),
    ("march", "kernels/law.h", "(1.0 + l->lam * rate) + l->c * rate; }", "(1.0 + l->lam * rate) - l->c * rate; }"),
    ("march", "kernels/law.h", "(l->p + 1.0); }", "l->p; }"),
    ("march", "kernels/law.h", "expm1((p + 1.0) * log1p(share))", "expm1(p * log1p(share))"),
    ("march", "kernels/law.h", "double below = 1.0 + slope * s + slope_rate * s_rate;", "double below = 1.0 + slope * s;"),
    ("march", "kernels/law.h", "1.0 + s * secant_slope(u, u0, sign * value, l)", "1.0 - s * secant_slope(u, u0, sign * value, l)"),
    ("model", "kernels/law.h", "if (a < 0.0 && b < 0.0) return -mean_elastic(-a, -b, l);", ""),
    ("march", "kernels/law.h", "return s * P >= d0 ? (Response){d0 / s, 1.0 / s, 0.0}", "return 0 ? (Response){d0 / s, 1.0 / s, 0.0}"),
    # kernels: rigid stops
    ("schemes", "kernels/march.c", "if (!(before[c] >= s->stops[2 * c + 1])) upper = INFINITY;", "if (!(before[c] <= s->stops[2 * c + 1])) upper = INFINITY;"),
    ("schemes", "kernels/node.c", "A[i * closed + j] = S[x->which[j] * wide + c]", "A[i * closed + j] = S[c * wide + x->which[j]]"),
    ("schemes", "kernels/march.c", "off <= ON_STOP * (size + fabs(stop))", "off < 0.0"),
    ("schemes", "kernels/march.c", "for (Int later = node + 1; later < S; later++)", "for (Int later = node + 2; later < S; later++)"),
    # the energy balance
    ("march", "trajectory/records.py", "if system.damped:\n", "if not system.damped:\n"),
    ("march", "trajectory/records.py", "if damping.ndim == 2 else _squares(x, damping)", "if damping.ndim == 2 else _squares(x)"),
    ("march", "trajectory/records.py", "d_input += 0.5 * (f[1:] + f[:-1])", "d_input += 0.5 * (f[1:] + f[1:])"),
    ("march", "trajectory/records.py", "taken -= dissipated", "taken += dissipated"),
    ("march", "trajectory/records.py", "work -= 0.5 * (force[1:] + force[:-1])", "work -= 0.5 * (force[1:] + force[1:])"),
    ("march", "trajectory/records.py", "else touching[1:] | touching[:-1]", "else touching[1:]"),
    ("march", "kernels/march.c", "starts + k / K * D", "starts"),
    # marches
    ("march", "march/block_march.py", "rows[:, IMPACT_IMPULSE] = 0.0 if self.treatment.means else 0.5", "rows[:, IMPACT_IMPULSE] = 0.5"),
    ("march", "trajectory/recorder.py", "np.flatnonzero(side[1:] != side[:-1]) + 1).tolist()", "np.flatnonzero(side[1:] != side[:-1])).tolist()"),
    ("march", "march/block_march.py", "if side and not since", "if not side and not since"),
    ("march", "march/block_march.py", "times = ((first + np.arange(steps))", "times = (np.arange(steps)"),
    ("march", "march/treatment.py", "predicts=True", "predicts=False"),
    ("march", "march/treatment.py", "return LINEAR if linear and", "return LINEAR if"),
    # schemes
    ("schemes", "schemes/newmark.py", "super().__init__(0.0, -self.alpha)", "super().__init__(0.0, 0.0)"),
    ("schemes", "schemes/newmark.py", "net_new = (a_new + inertia * a - of_old * net) / of_new", "net_new = a_new"),
    ("schemes", "schemes/newmark.py", "+ (0.5 - self.beta + self.beta * root) * one", "+ (0.5 - self.beta) * one"),
    ("schemes", "schemes/newmark.py", "return np.array([q, v, a, a])", "return np.array([q, v, 0.0 * a, a])"),
    ("schemes", "schemes/sdirk.py", "accelerations, strict=False))\n            v_i", "accelerations, strict=False)) * 0.5\n            v_i"),
    ("schemes", "schemes/sdirk.py", "self.nodes = (g, g + s, 1.0)", "self.nodes = (g, 1.0 - g, 1.0)"),
    ("schemes", "schemes/sdirk.py", "GAMMA_MIN, GAMMA_MAX = 0.1804253064293986", "GAMMA_MIN, GAMMA_MAX = 0.1304253064293986"),
    ("schemes", "schemes/first_order_form.py", "return Theta(0.5)", "return Theta(1.0)"),
    ("schemes", "schemes/first_order_form.py", "rate = 2.0 * y[1] - y_before[1]", "rate = y[1]"),
    ("schemes", "schemes/first_order_form.py", "(1.0 - s) ** 2 * y) /", "(1.0 - s) * y) /"),
    ("schemes", "schemes/first_order_form.py", "y, 0.5 * (f0 + f1) + reaction)", "y, f1 + reaction)"),
    ("schemes", "schemes/first_order_form.py", "return equation.flow(dt, y, f0 + reaction, f1 + reaction)", "return equation.flow(dt, y, f0, f1 + reaction)"),
    ("schemes", "schemes/rigid.py", "(1.0 - theta) * f + theta * loads[0] + reactions[0]", "loads[0] + reactions[0]"),
    ("schemes", "schemes/rigid.py", "y[1] - 0.5 * dt * bent", "y[1] + 0.5 * dt * bent"),
    ("schemes", "schemes/rigid.py", "return np.array([*history[0], a, a])", "return np.array([*history[0], 0.0 * a, a])"),
    ("schemes", "schemes/rigid.py", "force = 0.5 * (f + loads[1]) + reactions[1]", "force = loads[1] + reactions[1]"),
    ("schemes", "schemes/newmark.py", "(1.0 + alpha) * equation.net_force(ahead, none) - alpha", "(1.0 + alpha) * equation.net_force(ahead, none) + alpha"),
    ("schemes", "schemes/labels.py", "if parameter not in names:", "if False:"),
    ("schemes", "schemes/labels.py", 'r",(?![^(]*\\))"', 'r","'),
    # model
    ("model", "model/contact.py", "exact=True, least=plain)", "exact=True)"),
    ("model", "model/semidiscretisation.py", "moves = [(1.0 - share**2, problem.base)", "moves = [(1.0 - share, problem.base)"),
    ("model", "model/semidiscretisation.py", "np.maximum(0.0, 1.0 - np.abs(share * M", "np.maximum(0.0, 1.0 - np.square(share * M"),
    ("model", "model/semidiscretisation.py", "mass[-1] += problem.tip_mass", "mass[-1] += 0.5 * problem.tip_mass"),
    ("model", "model/beam.py", "L[0, :2] = (4.0, -0.5)", "L[0, :2] = (4.0, 0.5)"),
    ("model", "model/semidiscretisation.py", "drag = problem.viscosity * grid.bending + problem", "drag = problem"),
    ("model", "model/semidiscretisation.py", "- speed * (1.0 -", "+ speed * (1.0 -"),
    ("model", "model/semidiscretisation.py", "bending=2.0 / L**2 * slope", "bending=1.0 / L**2 * slope"),
    ("model", "model/modes.py", "(size <= rounding * terms) | (rest <= rounding * (terms + sums))", "size <= rounding * terms"),
    ("model", "model/modes.py", "else replace(basis, damping=diagonal)", "else replace(basis, damping=0.5 * diagonal)"),
    ("model", "model/modes.py", "(2.0 * np.array(ratios) *", "(1.0 * np.array(ratios) *"),
    ("model", "model/modes.py", "squares, shapes = graded_eigenpairs(system.mass, system.stiffness, factor, squares, start)", "shapes = start"),
    ("model", "model/modes.py", "kept = np.imag(values) >= 0.0", "kept = np.imag(values) > 0.0"),
    ("model", "model/modes.py", "values = values + np.where(single", "values = values - 0.0 * np.where(single"),
    ("model", "model/members.py", "(members, 2, system.size))", "(1, 2, system.size)).repeat(members, 0)"),
    ("march", "model/members.py", "v0 = (system.v0 + speed", "v0 = (system.v0 + 0.5 * speed"),
    ("model", "model/members.py", "index or range(len(stops))", "index or [0]"),
    ("model", "model/members.py", "if placed.setdefault(keys, sign * value) != sign * value:", "if False:"),
    ("march", "model/members.py", "others != functions or ", ""),
    ("schemes", "model/equations.py", "(Q[..., 0], force1 - force0)", "(Q[..., 0], force1)"),
    ("model", "model/time_functions.py", "function.frequency, function.phase + np.pi / 2)", "function.frequency, function.phase - np.pi / 2)"),
    ("model", "model/time_functions.py", "number(\"Superposition.terms\", factor) * inner), leaf)", "inner), leaf)"),
    ("model", "model/time_functions.py", "f.amplitude * math.cos(f.phase)", "f.amplitude * math.sin(f.phase)"),
    ("references", "references/horizon.py", "float(min(a.t[-1], b.t[-1]))", "float(a.t[-1])"),
    ("references", "references/exact/tangent.py", "for k in range(last - 1, first - 1, -1):", "for k in range(last - 1, first, -1):"),
    ("model", "model/time_functions.py", "self.derivative + times)", "self.derivative)"),
    ("model", "model/reduction.py", "/ np.sqrt(squares[-modes:])", "/ squares[-modes:]"),
    ("model", "model/reduction.py", "[replace(contact, row=T.T @ contact.row) for", "[replace(contact, row=T.T @ contact.row, offset=None) for"),
    ("model", "model/reduction.py", "> LOST * (static @ (K @ static)):", "> np.inf:"),
    ("model", "model/scales.py", "np.sqrt(2.0 * stored), *moving, 0.0", "*moving, 0.0"),
    ("model", "model/scales.py", "square[towards] = np.minimum(square[towards], 2.0 *", "square[towards] = np.minimum(square[towards], 1.0 *"),
    ("references", "model/system_data.py", "[4.0, -6.0, 4.0, -1.0]", "[4.0, -6.0, 4.0, 1.0]"),
    ("model", "model/system.py", "self.keeps(\"mass\", \"damping\", \"stiffness\")", "self.keeps(\"mass\", \"damping\")"),
    ("model", "basics/validation.py", "return read_only(value) if isinstance(value, np.ndarray) else value", "return value"),
    ("model", "model/beam.py", "stencil[0, 0] = 7.0", "stencil[0, 0] = 6.0"),
]  # fmt: skip

SOURCES = Path(__file__).parents[2] / "src"
LONGEST = 1800.0  # seconds that the tests of a room may take


def wrong(root: Path, room: str, sources: Path, slow: bool) -> tuple[str, float]:
    """The first test of the room that fails with these sources, "" where none does, and the seconds that it took."""
    command = [sys.executable, "-m", "pytest", "-n", "0", "-q", "-x", "--tb=line", "-p", "no:cacheprovider"]
    command += ["-m", "slow or not slow"] if slow else []
    first = f"tests/{room}/test_{room}.py"
    command += [first] if (root / first).exists() else []
    cache = Path(tempfile.mkdtemp(dir=sources.parent))
    environment = os.environ | {
        "PYTHONPATH": str(sources), "OPENBLAS_NUM_THREADS": "1", "STIFFBEAM_CACHE_DIR": str(cache),
    }  # fmt: skip
    begun = time.monotonic()
    try:
        done = subprocess.run(
            [*command, f"tests/{room}"], cwd=root, env=environment, capture_output=True, text=True, check=False,
            timeout=LONGEST,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return "a test that does not end", LONGEST
    found = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    test = "" if not done.returncode else found[1] if found else f"exit status {done.returncode}"
    return test, time.monotonic() - begun


SOUND = ("schemes", "schemes/first_order_form.py", "c = 2.0 * dt / 3.0", "c = 2.0 * dt / 3.0")  # fmt: skip  # --only -1: nothing fails


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", type=Path, default=SOURCES.parent)
    parser.add_argument("--only", default="")
    parser.add_argument("--room", default="")
    parser.add_argument("--slow", action="store_true")
    given = parser.parse_args()
    numbers = [int(x) for x in given.only.split(",") if x] or range(len(FAULTS))
    missed = 0
    with tempfile.TemporaryDirectory() as folder:
        sources = Path(folder) / "src"
        shutil.copytree(SOURCES, sources)
        shutil.copytree(SOURCES.parent / "reference", Path(folder) / "reference")
        for number in numbers:
            room, name, there, put = FAULTS[number] if number >= 0 else SOUND
            if given.room not in ("", room):
                continue
            file = sources / "stiffbeam" / name
            text = file.read_text(encoding="utf-8")
            if text.count(there) != 1:
                print(f"{number:3}  STALE   {name}: {there}", flush=True)
                missed += 1
                continue
            file.write_text(text.replace(there, put), encoding="utf-8")
            test, seconds = wrong(given.root.resolve(), room, sources, given.slow)
            file.write_text(text, encoding="utf-8")
            missed += not test
            print(
                f"{number:3}  {'caught' if test else 'MISSED'}  {seconds:4.0f} s  {name}: {there[:60]!r}  {test}",
                flush=True,
            )
    return missed > 0


if __name__ == "__main__":
    sys.exit(main())
