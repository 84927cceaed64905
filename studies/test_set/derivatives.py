"""Derivatives of the answers with respect to parameters and initial data, by two ways that share no code.

1. Differences of order 8 of the way that made the answers, with steps of 2^-20 of the parameter: h^8 is 1e-48.
2. Taylor series in MPFR with the variational equations that heyoka derives. Time and parameters are unknowns too, so
   that the event condition alone gives the change of the derivative at an event.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mpmath as mp
from truth import Truth

STEP = 2.0**-20  # of the parameter: parameter and step have few binary digits, so that their sums are doubles
ORDER_8 = (mp.mpf(4) / 5, -mp.mpf(1) / 5, mp.mpf(4) / 105, -mp.mpf(1) / 280)
AGREEMENT = mp.mpf(10) ** -22  # relative, of the two ways
NEAR = 1e-40  # no gap is exactly 0 at the start of a step, where heyoka 7.13 loses a second root
LAW = ("stiffness", "upper", "damping", "dissipation", "restitution")


def derivatives(
    data: Mapping[str, Any], t_end: float, paths: Sequence[str], truth: Callable[[Mapping[str, Any]], Truth]
) -> dict[str, tuple[Any, Any]]:
    """Derivatives of tip and tip velocity at t_end by path. Raises AssertionError where the two ways differ."""
    _, by_series = tangent(data, t_end, paths)
    found = {}
    for path in paths:
        differences = by_differences(data, path, truth)
        for one, other in zip(differences, by_series[path], strict=True):
            scale = max(map(abs, differences))
            assert abs(one - other) <= AGREEMENT * scale, (path, mp.nstr(one, 30), mp.nstr(other, 30))
        found[path] = differences
    return found


def place(data: Any, path: str) -> tuple[Any, Any]:
    """The table or list that holds a parameter, and its key: "contacts[0].stops.upper", "v0[1]"."""
    names = {"q0": "initial_displacement", "v0": "initial_velocity"}
    keys: list[Any] = [int(x[1:-1]) if x.startswith("[") else names.get(x, x) for x in re.findall(r"\w+|\[\d+\]", path)]
    keys = [key for key in keys if key not in ("stops", "time")]
    for key in keys[:-1]:
        data = data[key]
    return data, keys[-1]


def by_differences(data: Mapping[str, Any], path: str, truth: Callable[[Mapping[str, Any]], Truth]) -> tuple[Any, Any]:
    """Derivatives of tip and tip velocity at t_end."""
    holder, key = place(data, path)
    h = STEP * 2.0 ** math.floor(math.log2(abs(holder[key]) or 1.0))
    total = [mp.mpf(0), mp.mpf(0)]
    for k, weight in enumerate(ORDER_8, start=1):
        ends = []
        for sign in (1, -1):
            changed = copy.deepcopy(dict(data))
            table, key = place(changed, path)
            value = table[key] + sign * k * h
            assert mp.mpf(value) == mp.mpf(table[key]) + sign * k * mp.mpf(h), "the sum is no double"
            table[key] = value
            motion = truth(changed)
            ends.append((motion.tip[-1], motion.velocity[-1]))
        total = [x + weight * (a - b) / mp.mpf(h) for x, a, b in zip(total, *ends, strict=True)]
    return total[0], total[1]


class Number:
    """Numbers of heyoka with ``bits`` binary digits, or doubles."""

    def __init__(self, hy: Any, bits: int) -> None:
        self.options: dict[str, Any] = {"fp_type": hy.real if bits > 53 else float, "compact_mode": True}
        self.make: Callable[[Any], Any] = float
        self.tolerance: Any = 2.0**-52
        if bits > 53:
            digits = int(bits * 0.30103) + 2
            self.make = lambda x: hy.real(mp.nstr(mp.mpf(x), digits), bits)
            self.tolerance = self.make(mp.mpf(2) ** (4 - bits))
            self.options["prec"] = bits


def tangent(
    data: Mapping[str, Any], t_end: float, paths: Sequence[str], bits: int = 170
) -> tuple[Any, dict[str, tuple[Any, Any]]]:
    """Tip at t_end, and by path its derivative and that of its velocity: heyoka's variational equations.

    For one contact of one unknown with a stop above, and a diagonal mass.
    """
    import heyoka as hy

    number, n, contact = Number(hy, bits), len(data["initial_displacement"]), data["contacts"][0]
    j, p = contact["row"].index(1.0), contact.get("exponent", 1.0)
    law = {name: contact.get(name, 0.0) for name in LAW}
    rigid = math.isinf(law["stiffness"])
    mine = {path: place(data, path) for path in paths}
    own = [name for name in LAW if any(table is contact and key == name for table, key in mine.values())]

    # Unknowns q, v, t, the law's parameters among the paths, and in a Hertzian contact w with the depth w^2.
    symbols = {name: hy.expression(name) for name in own}
    value = {name: symbols.get(name, hy.expression(law[name])) for name in LAW if math.isfinite(law[name])}
    q, v = ([hy.expression(f"{x}{i}") for i in range(n)] for x in "qv")
    t, w = hy.expression("t"), hy.expression("w")

    def program(closed: bool) -> tuple[Any, list[Any]]:
        root = closed and p != 1.0
        depth, speed = q[j] - value["upper"], v[j]
        forces = [hy.expression(0.0)] * n
        for load in data.get("loads", ()):
            wave = load.get("constant")
            if wave is None:
                wave = load["amplitude"] * hy.sin(load["frequency"] * t + load["phase"])
            forces = [f + x * wave for f, x in zip(forces, load["vector"], strict=True)]
        for i in range(n):
            forces[i] -= hy.sum([k * x for k, x in zip(data["stiffness"][i], q, strict=True)])
        press = hy.expression(0.0)
        if closed:
            elastic = value["stiffness"] * (w * w * w if root else depth)
            press = elastic * (1.0 + value["dissipation"] * speed) + value["damping"] * speed
            forces[j] -= press
        pace = w if root else hy.expression(1.0)
        equations = [(q[i], pace * v[i]) for i in range(n)]
        # heyoka would turn a division by a double into a product with its reciprocal, a double again.
        equations += [(v[i], pace * forces[i] * inverse[i]) for i in range(n)]
        equations += [(t, pace), *((symbols[name], hy.expression(0.0)) for name in own)]
        equations += [(w, 0.5 * speed)] if root else []
        event = (-w if root else -press if law["damping"] else -depth) if closed else depth
        conditions = [event - NEAR, t - t_end]
        events = [
            hy.t_event(c, direction=hy.event_direction.positive, fp_type=number.options["fp_type"]) for c in conditions
        ]
        system = hy.var_ode_sys(equations, hy.var_args.vars, order=1)
        size = len(equations)
        series = hy.taylor_adaptive(
            system, state=[number.make(0)] * size, tol=number.tolerance, t_events=events, **number.options
        )
        rates = [rate for _, rate in equations]
        gradients = [hy.diff(c, variable) for c in conditions for variable, _ in equations]
        form = hy.cfunc([*rates, *gradients], [x for x, _ in equations],
                        **{k: x for k, x in number.options.items() if k != "compact_mode"})  # fmt: skip
        return series, [form, size]

    with mp.workdps(int(bits * 0.30103) + 10):
        inverse = [hy.expression(number.make(1 / mp.mpf(data["mass"][i][i]))) for i in range(n)]
    programs: dict[bool, Any] = {}
    with mp.workdps(int(bits * 0.30103) + 10):
        state = mp.matrix([*data["initial_displacement"], *data["initial_velocity"], 0.0, *(law[x] for x in own)])
        D = mp.zeros(len(state), len(paths))
        for column, (table, key) in enumerate(mine.values()):
            row = 2 * n + 1 + own.index(key) if table is contact else key
            row += n if table is data["initial_velocity"] else 0
            D[row, column] = 1
        depth = data["initial_displacement"][j] - law["upper"]
        closed = depth > 0.0 or (depth == 0.0 and data["initial_velocity"][j] > 0.0)
        while True:
            root = closed and p != 1.0
            if closed not in programs:
                programs[closed] = program(closed)
            series, (form, size) = programs[closed]
            begin = [*state, 0] if root else list(state)
            eye = [1 if i == k else 0 for i in range(size) for k in range(size)]
            series.state[:] = [number.make(x) for x in [*begin, *eye]]
            series.time = number.make(0)
            series.reset_cooldowns()
            outcome = 0
            # Where the last terms of a series vanish together, as at w = 0, they set no step.
            longest = number.make(_contact_scale(data) / 30.0 if root else t_end / 20.0)
            while not -2 <= outcome < 0:
                outcome = int(series.step(longest)[0])
                assert mp.isfinite(mp.mpf(str(series.time)))
            final = [mp.mpf(str(x)) for x in series.state]
            flow = mp.matrix(size, size)
            for i in range(size):
                for k in range(size):
                    flow[i, k] = final[size + i * size + k]
            held = mp.zeros(size, len(paths))
            held[: len(state), :] = D
            D, ended = flow * held, -outcome - 1
            forms = [mp.mpf(str(x)) for x in form([number.make(x) for x in final[:size]])]
            rate, slope = mp.matrix(forms[:size]), mp.matrix(forms[size * (1 + ended) : size * (2 + ended)]).T
            D = D - rate * (slope * D) / (slope * rate)[0]  # the event moves along the motion, and with it the time
            state, D = mp.matrix(final[: len(state)]), D[: len(state), :]
            if ended == 1:
                return state[j], {path: (D[j, c], D[n + j, c]) for c, path in enumerate(paths)}
            if rigid:
                e = state[2 * n + 1 + own.index("restitution")] if "restitution" in own else mp.mpf(law["restitution"])
                for c in range(len(paths)):
                    change = D[2 * n + 1 + own.index("restitution"), c] if "restitution" in own else 0
                    D[n + j, c] = -e * D[n + j, c] - state[n + j] * change
                state[n + j] = -e * state[n + j]
            else:
                closed = not closed


def _contact_scale(data: Mapping[str, Any]) -> float:
    """s of a Hertzian contact, ds = dt/w, with the speed of the start."""
    contact, speed = data["contacts"][0], abs(data["initial_velocity"][0])
    depth = (1.25 * data["mass"][0][0] * speed**2 / contact["stiffness"]) ** 0.4
    return math.sqrt(depth) / speed
