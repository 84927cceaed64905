"""Make the frozen orbits anew: systems and proved enclosures under reference/orbits.

python studies/test_set/make_orbits.py              everything, a minute
python studies/test_set/make_orbits.py NAME ...     these orbits and the page
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import flint
import numpy as np
from make import toml
from systems import INF, drive, table_of

import stiffbeam as sb
from stiffbeam.testset.problem import read_orbit, system_of

FOLDER = Path(__file__).parents[2] / "reference" / "orbits"
DIGITS, SAMPLES = 25, 64


@dataclass(frozen=True)
class OrbitDefinition:
    """An orbit: its system as in the file, periods of the drive, and a state near it at t = 0, if any."""

    name: str
    title: str
    system: Callable[[], dict[str, Any]] = field(repr=False)
    frequency: float
    guess: tuple[Sequence[float], Sequence[float]] | None = None
    turns: int = 1


def one(frequency: float, c: float, amplitude: float, **stops: float) -> Callable[[], dict[str, Any]]:
    """One mass 1 on a spring 1 with a dashpot c, driven, with one stop or two."""
    return lambda: {
        "mass": [[1.0]], "stiffness": [[1.0]], "damping": [[c]], "loads": drive(amplitude, frequency, 0.0),
        "contacts": [{"row": [1.0], **stops}],
    }  # fmt: skip


def chain(
    stiffness: list[list[float]], c: float, load: list[float], wave: tuple[float, float], *contacts: dict[str, Any]
) -> Callable[[], dict[str, Any]]:
    """Masses 1 with damping c times the stiffness and a driven one."""
    return lambda: {
        "mass": np.eye(len(stiffness)).tolist(), "stiffness": stiffness,
        "damping": (c * np.array(stiffness)).tolist(),
        "loads": [{"vector": load, "amplitude": wave[0], "frequency": wave[1], "phase": 0.0}],
        "contacts": list(contacts),
    }  # fmt: skip


def beam(frequency: float) -> Callable[[], dict[str, Any]]:
    """The viscous beam with 8 cells and a moving base between the stops."""

    def table() -> dict[str, Any]:
        stops, base = sb.Stops(-0.1, 0.1, stiffness=5e6), sb.Harmonic(0.2, frequency)
        problem = sb.BeamProblem(stiffness=300.0, viscosity=0.05, stops=stops, base=base)
        return table_of(sb.semidiscretise(problem, 8))

    return table


TWO, THREE = [[2.0, -1.0], [-1.0, 1.0]], [[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]]
STIFF = {"upper": 0.0, "stiffness": INF, "restitution": 0.8}
MOVING = {
    "row": [1.0], "upper": 0.4, "stiffness": 25.0, "offset": {"amplitude": 0.2, "frequency": 1.5, "phase": 1.0}
}  # fmt: skip
DEFINITIONS = (
    OrbitDefinition("bilinear-free", "One mass before a stop, without contact; two more orbits beside it",
                    one(1.28, 0.1, 0.3, upper=0.5, stiffness=4.0), 1.28, ([-0.0906], [-0.5783])),
    OrbitDefinition("bilinear-unstable", "One mass and a stop, between the folds",
                    one(1.28, 0.1, 0.3, upper=0.5, stiffness=4.0), 1.28, ([-0.3444], [-0.8407])),
    OrbitDefinition("bilinear-resonant", "One mass and a stop, the large motion",
                    one(1.28, 0.1, 0.3, upper=0.5, stiffness=4.0), 1.28, ([-2.6306], [0.6793])),
    OrbitDefinition("two-sided", "One mass between two stops, the large motion",
                    one(1.5, 0.05, 0.6, lower=-0.5, upper=0.5, stiffness=20.0), 1.5, ([-0.0389], [0.7034])),
    OrbitDefinition("two-sided-unstable", "One mass between two stops, between the folds",
                    one(1.5, 0.05, 0.6, lower=-0.5, upper=0.5, stiffness=20.0), 1.5, ([-0.032], [-0.7551])),
    OrbitDefinition("stiff-stop", "One mass and a stiff stop, past a flip",
                    one(3.0, 0.05, 1.0, upper=0.0, stiffness=50.0), 3.0, ([-0.1548], [-0.4604])),
    OrbitDefinition("kelvin-voigt", "One mass and a stop with damping, whose force jumps",
                    one(1.4, 0.1, 1.0, upper=0.2, stiffness=50.0, damping=1.5), 1.4, ([-1.5333], [0.5779])),
    OrbitDefinition("moving-stop", "One mass and a stop that moves",
                    lambda: {**one(1.5, 0.1, 0.5, upper=0.4, stiffness=25.0)(), "contacts": [MOVING]}, 1.5),
    OrbitDefinition("impact-oscillator", "One mass and a rigid stop", one(2.8, 0.02, 1.0, **STIFF), 2.8,
                    ([-0.292], [-0.5775])),
    OrbitDefinition("impact-oscillator-doubled", "One mass and a rigid stop, two periods of the drive",
                    one(2.8, 0.02, 1.0, **STIFF), 2.8, ([-0.1234], [-0.4438]), turns=2),
    OrbitDefinition("impact-oscillator-stable", "One mass and a rigid stop, twice its frequency",
                    one(2.0, 0.02, 1.0, **(STIFF | {"restitution": 0.6})), 2.0, ([-2.5129], [-0.6255])),
    OrbitDefinition("two-masses", "Two masses, the second before a stop",
                    chain(TWO, 0.1, [0.0, 1.0], (0.4, 0.9), {"row": [0.0, 1.0], "upper": 0.25, "stiffness": 50.0}),
                    0.9, ([-0.4808, -1.282], [0.2903, -0.166])),
    OrbitDefinition("two-masses-unstable", "Two masses, the second before a stop, past a flip",
                    chain(TWO, 0.05, [0.0, 1.0], (0.6, 1.6), {"row": [0.0, 1.0], "upper": 0.25, "stiffness": 50.0}),
                    1.6, ([0.3776, -0.821], [-1.3551, 0.4908])),
    OrbitDefinition("two-masses-rigid", "Two masses, the second before a rigid stop",
                    chain(TWO, 0.1, [0.0, 1.0], (0.4, 1.1),
                          {"row": [0.0, 1.0], "upper": 0.25, "stiffness": INF, "restitution": 0.7}),
                    1.1, ([-0.9142, -0.994], [-0.393, -0.2844])),
    OrbitDefinition("masses-that-meet", "Two masses on springs that hit each other, with damping",
                    chain([[1.0, 0.0], [0.0, 2.0]], 0.1, [1.0, -0.5], (0.5, 1.1),
                          {"row": [1.0, -1.0], "upper": 0.2, "stiffness": 60.0, "damping": 0.8}),
                    1.1, ([-0.8222, 0.0467], [0.2353, 0.5833])),
    OrbitDefinition("three-masses", "Three masses and two stops, a complex pair outside the circle",
                    chain(THREE, 0.06, [1.0, 0.0, 0.0], (0.5, 1.2),
                          {"row": [0.0, 0.0, 1.0], "upper": 0.3, "stiffness": 40.0},
                          {"row": [0.0, 1.0, 0.0], "lower": -0.2, "stiffness": 40.0}),
                    1.2, ([-0.5915, 0.4176, -0.0732], [1.0764, 0.8261, -0.4095])),
    *(OrbitDefinition(f"beam-{w:.0f}", f"Beam with 8 cells between stops, base at frequency {w:.0f}", beam(w), w)
      for w in (24.0, 28.0, 33.0, 45.0, 57.0)),
)  # fmt: skip


def decimals(balls: Sequence[Any], scale: Any) -> tuple[list[str], Any]:
    """Texts of numbers to ``DIGITS`` below ``scale``, and a bound of their distances from the true ones."""
    texts, bound = [], flint.arb(0)
    for ball in balls:
        size = float(abs(ball.mid()) / scale)
        digits = max(1, DIGITS + (math.floor(math.log10(size)) + 1 if size > 0.0 else -DIGITS))
        text = ball.mid().str(digits, radius=False) if size > 10.0**-DIGITS else "0"
        away = abs(flint.arb(text) - ball).upper()
        texts.append(text)
        bound = away if away > bound else bound
    return texts, bound


def answer(name: str, rows: Sequence[Sequence[Any]], flat: bool) -> list[str]:
    """An [answers.name] of rows of balls."""
    scale = max((abs(x).upper() for row in rows for x in row), key=float, default=flint.arb(1))
    scale = scale if scale > 0 else flint.arb(1)
    pairs = [decimals(row, scale) for row in rows]
    bound = max((float(radius) for _, radius in pairs), default=0.0)
    radius = f"{bound * 1.1:.1e}" if bound else "0"  # rounded to nearest: a tenth more is enough
    texts = [row[0] for row, _ in pairs] if flat else [row for row, _ in pairs]
    return ["", f"[answers.{name}]", "value = [", *(f"  {toml(x)}," for x in texts), "]", f'radius = "{radius}"']


def file_text(definition: OrbitDefinition) -> str:
    """The file of an orbit. Raises RuntimeError for one that is not proved."""
    data = definition.system()
    period = definition.turns * 2.0 * np.pi / definition.frequency
    guess, file = definition.guess, FOLDER / f"{definition.name}.toml"
    if guess is None and file.exists():  # the motion is chaotic: a run need not end near the same orbit again
        frozen = read_orbit(file.read_text(encoding="utf-8"))
        guess = frozen.q[0], frozen.v[0]
    orbit = sb.periodic_orbit(system_of(definition.name, data), period, guess)
    proof = orbit.prove()
    if not proof.proved or proof.stable is None:
        raise RuntimeError(f"{definition.name}: {proof}")
    q, v = proof.states(SAMPLES)
    tables = {key: data.pop(key) for key in ("loads", "contacts") if key in data}
    lines = [
        "# A periodic orbit with proved enclosures. Made by studies/test_set/make_orbits.py; see README.md.",
        f"name = {toml(definition.name)}", f"title = {toml(definition.title)}",
        f"period = {float(proof.period)!r}", f"period_text = {toml(proof.period_text)}",
        f"stable = {toml(proof.stable)}", f"bits = {proof.bits}", f"itinerary = {toml(proof.itinerary)}",
        "", "[system]",
        *(f"{key} = {toml(value)}" for key, value in data.items() if not key.startswith("initial_")),
    ]  # fmt: skip
    for key, entries in tables.items():
        for table in entries:
            lines += ["", f"[[system.{key}]]", *(f"{k} = {toml(x)}" for k, x in table.items())]
    with flint.ctx.workprec(proof.bits):
        lines += answer("event_times", [[t] for t in proof.event_times], flat=True)
        lines += answer("q", q, flat=False) + answer("v", v, flat=False)
        lines += answer("multipliers_real", [[x.real] for x in proof.multipliers], flat=True)
        lines += answer("multipliers_imag", [[x.imag] for x in proof.multipliers], flat=True)
    return "\n".join(lines) + "\n"


def page() -> str:
    """reference/orbits/README.md."""
    text = (Path(__file__).with_name("orbits.md")).read_text(encoding="utf-8")
    lines = ["| orbit | | size | events | largest multiplier | |", "|---|---|---|---|---|---|"]
    for orbit in sb.frozen_orbits().values():
        mu = complex(orbit.multipliers[0])
        value = f"{mu.real:.6f}" + (f" ± {abs(mu.imag):.6f} i" if mu.imag else "")
        kind = "stable" if orbit.stable else "unstable"
        cells = (
            f"[{orbit.name}]({orbit.name}.toml)",
            orbit.title,
            orbit.system.size,
            len(orbit.itinerary),
            value,
            kind,
        )
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return text.replace("TABLE", "\n".join(lines))


def main(names: list[str]) -> None:
    FOLDER.mkdir(exist_ok=True)
    for definition in DEFINITIONS:
        if not names or definition.name in names:
            begun = time.perf_counter()
            (FOLDER / f"{definition.name}.toml").write_text(file_text(definition), encoding="utf-8")
            print(f"{definition.name}: {time.perf_counter() - begun:.1f} s", flush=True)
    (FOLDER / "README.md").write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
