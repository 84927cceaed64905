"""Derivatives of the answers with respect to parameters and initial data.

Differences of order 8 of the code that made the answers, with steps of 2^-20 of the parameter: h^8 is 1e-48. When they
were frozen, Taylor series in MPFR with variational equations (heyoka) gave the same 22 digits.
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


def derivatives(
    data: Mapping[str, Any], paths: Sequence[str], truth: Callable[[Mapping[str, Any]], Truth]
) -> dict[str, tuple[Any, Any]]:
    """Derivatives of tip and tip velocity at t_end by path."""
    return {path: by_differences(data, path, truth) for path in paths}


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
