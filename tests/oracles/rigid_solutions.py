"""Motions between rigid stops in 40 digits and more, rounded to float64: frozen when the solver that made them left.

It went by power series in ball arithmetic and shared no code with the exact solution in float64.
"""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np

SOLUTIONS = json.loads(Path(__file__).with_suffix(".json").read_text(encoding="utf-8"))
RANDOM = [int(name.partition(" ")[2]) for name in SOLUTIONS if name.startswith("random")]


def known(name: str) -> SimpleNamespace:
    """t_end, horizon; tip, and of each contact position, at every ``every``-th output of the test; impulse, fraction,
    and the impacts' times, ends, impulses and stops, NaN where they are not over."""
    entry = dict(SOLUTIONS[name])
    contacts = [
        SimpleNamespace(**{key: np.array(x, float) if isinstance(x, list) else x for key, x in contact.items()})
        for contact in entry.pop("contacts")
    ]
    return SimpleNamespace(**entry | {"tip": np.array(entry["tip"]), "contacts": contacts})
