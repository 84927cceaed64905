"""What varies along a beam or between its modes: sections of other stiffness and mass, damping ratios."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.validation import InputError, non_negative, positive


@dataclass(frozen=True)
class Section:
    """Where begin <= x <= end the beam has ``stiffness`` times its EI and eta, and ``mass`` times its mass and rotary
    inertia per length. Raises InputError unless 0 <= begin < end and both factors are positive."""

    begin: float
    end: float
    stiffness: float = 1.0
    mass: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "begin", non_negative("section.begin", self.begin))
        for name in ("end", "stiffness", "mass"):
            object.__setattr__(self, name, positive(f"section.{name}", getattr(self, name)))
        if not self.begin < self.end:
            remedy = "exchange them, or move the end"
            raise InputError("section.end", self.end, f"be > section.begin = {self.begin:g}", remedy)


def checked(sections: Sequence[Section], length: float) -> tuple[Section, ...]:
    """In order along the beam. Raises InputError for sections that overlap or leave it."""
    for section in sections:
        if not isinstance(section, Section):
            raise InputError("sections", section, "be Section objects", "for example Section(0.0, 0.2, stiffness=2.0)")
    found = tuple(sorted(sections, key=lambda s: s.begin))
    for one, after in pairwise(found):
        if after.begin < one.end:
            raise InputError(
                "section.begin",
                after.begin,
                f"be at or past the end {one.end:g} of the one before",
                "let sections follow each other, each beginning where the one before ends",
            )
    if found and found[-1].end > length * (1 + 1e-12):
        raise InputError("section.end", found[-1].end, f"lie on the beam, to {length:g}", "shorten the section")
    return found


def factors(sections: Sequence[Section], x: ArrayLike, name: str) -> Array:
    """The factor ``name`` at x, 1 outside the sections; at a joint that of the section which begins there."""
    x = np.asarray(x, float)
    found = np.ones(x.shape)
    for section in sections:
        found[(x >= section.begin) & (x <= section.end)] = getattr(section, name)
    return found


def element_factors(sections: Sequence[Section], length: float, M: int, name: str) -> Array:
    """Of M equal elements, (M,). Raises InputError where a section does not end at a node."""
    for section in sections:
        for x in (section.begin, section.end):
            share = x / length * M
            if abs(share - round(share)) > 1e-9 * M:
                remedy = "take a number of cells that divides the beam there"
                raise InputError("cells", M, f"put a node where a section ends, x = {x:g}", remedy)
    return factors(sections, length * (np.arange(M) + 0.5) / M, name)


def ratios_of(value: float | Sequence[float]) -> float | tuple[float, ...]:
    """A damping ratio for every mode, or one for each of the first modes; >= 0."""
    if isinstance(value, (list, tuple, np.ndarray)):
        return tuple(non_negative("modal_damping", x) for x in value)
    return non_negative("modal_damping", value)
