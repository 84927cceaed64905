"""What many runs have seen, as arrays: what an ensemble is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array, BoolArray
from .impacts import Impacts
from .recorder import Seen


@dataclass(frozen=True, eq=False, kw_only=True)
class Records:
    """What M runs have seen with their m contacts.

    tip, tip_velocity: (M, k) at the output times. fraction, peak_force, impulse: (M, m), see ContactRecord.
    open_at_start: (M, m), contacts that are there at t = 0, which are no impacts, see ``Impacts.at_start``. impacts: of
    every contact those of all runs, one run after the other; whose: of every contact the run of each. diverged: (M,),
    NaN for none. marches: how the runs were made.
    """

    tip: Array
    tip_velocity: Array
    fraction: Array
    peak_force: Array
    impulse: Array
    open_at_start: BoolArray
    impacts: tuple[Impacts, ...]
    whose: tuple[NDArray[np.int64], ...]
    diverged: Array
    marches: frozenset[str]

    def __len__(self) -> int:
        return len(self.diverged)

    @classmethod
    def of(cls, seen: Sequence[Seen]) -> Records:
        """Of runs that were recorded one by one, at least one."""
        runs, m = [one.contacts for one in seen], len(seen[0].contacts)
        numbers = [[[r.fraction, r.peak_force, r.impulse] for r in records] for records in runs]
        fraction, peak_force, impulse = np.array(numbers, float).reshape(len(seen), m, 3).transpose(2, 0, 1)
        impacts = [[records[c].impacts for records in runs] for c in range(m)]
        return cls(
            tip=np.array([one.tip for one in seen]),
            tip_velocity=np.array([one.tip_velocity for one in seen]),
            fraction=fraction,
            peak_force=peak_force,
            impulse=impulse,
            open_at_start=np.array([[r.impacts.at_start is not None for r in records] for records in runs], bool),
            impacts=tuple(Impacts.concatenate(each) for each in impacts),
            whose=tuple(np.repeat(np.arange(len(seen)), [one.count for one in each]) for each in impacts),
            diverged=np.array([one.diverged for one in seen]),
            marches=frozenset(one.march for one in seen),
        )

    @classmethod
    def joined(cls, parts: Sequence[Records], places: Sequence[int] | None = None) -> Records:
        """One after the other; places: where each run then belongs, (M,), None for there."""
        if len(parts) == 1:
            return parts[0]
        names = ("tip", "tip_velocity", "fraction", "peak_force", "impulse", "open_at_start", "diverged")
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        first = np.cumsum([0, *(len(part) for part in parts[:-1])])
        whose, impacts = [], []
        for c in range(len(parts[0].impacts)):
            whose.append(np.concatenate([part.whose[c] + k for part, k in zip(parts, first, strict=True)]))
            impacts.append(Impacts.concatenate([part.impacts[c] for part in parts]))
        if places is not None:
            place = np.array(places)
            arrays = {name: values[np.argsort(place)] for name, values in arrays.items()}
            for c, of in enumerate(whose):
                order = np.argsort(place[of], kind="stable")
                whose[c], impacts[c] = place[of][order], impacts[c].take(order)
        marches = frozenset[str]().union(*(part.marches for part in parts))
        return cls(**arrays, whose=tuple(whose), impacts=tuple(impacts), marches=marches)
