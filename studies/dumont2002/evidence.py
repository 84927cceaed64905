"""The evidence for claims: the tables' numbers, their ensembles, the costs, and how the paper was read."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .ensembles import SEEDS, Numbers
from .reading import Reading
from .sample import Sample

FORM_OF = {"displacement": "(3.5)", "velocity-curvature": "(3.12)"}


class NotMeasured(Exception):
    """There are no numbers to test a claim with; the message says why."""


@dataclass(frozen=True)
class Evidence:
    """seeds: the sets of members in use, all of them or one.

    A motion is named by the paper's equation number, or by its form for the exact motion.
    """

    tables: dict[int, Numbers]
    costs: list[dict[str, Any]]
    reading: Reading
    seeds: tuple[int, ...] = SEEDS

    def of(self, *seeds: int) -> Evidence:
        """Evidence of these sets of members alone."""
        return replace(self, seeds=seeds)

    def runs(self, table: int) -> list[str]:
        """The equations that the table compares, all of them or NotMeasured."""
        failed = self.tables[table]["failures"]
        lost = [name for name, row in self.tables[table]["runs"].items() if not row["ensemble"]]
        if failed or lost:
            raise NotMeasured(f"{', '.join([*failed, *lost])} overflowed on Table {table}")
        return list(self.tables[table]["runs"])

    def forms(self, table: int) -> list[str]:
        """The forms in which the exact motion was computed."""
        return list(self.tables[table]["exact"])

    def row(self, table: int, motion: str) -> Numbers:
        """The numbers of one run, or of the exact motion in one form; NotMeasured for a run that overflowed."""
        found = self.tables[table]
        if motion in found["exact"]:
            return found["exact"][motion]
        if motion not in found["runs"]:
            raise NotMeasured(f"{motion} overflowed on Table {table}")
        return found["runs"][motion]

    def values(self, table: int, motion: str, what: str) -> np.ndarray:
        """A measure of the members, one row a member."""
        ensemble = self.row(table, motion)["ensemble"]
        found = [x for seed in self.seeds if str(seed) in ensemble for x in ensemble[str(seed)][what]]
        if not found:
            raise NotMeasured(f"no member of {motion} on Table {table} went through")
        return np.array(found, float)

    def sample(self, table: int, motion: str, what: str) -> Sample:
        """A measure of the members as a sample; NotMeasured where none went through."""
        return Sample(self.values(table, motion, what))

    def apart(self, table: int, a: str, b: str) -> Sample:
        """Difference of two motions, see ``add_ensembles``; with a = b, of two members of one."""
        found = self.tables[table]["apart"]
        by_seed = found.get(f"{a} | {b}") or found.get(f"{b} | {a}") or {}
        values = [x for seed in self.seeds for x in by_seed.get(str(seed), [])]
        if not values:
            raise NotMeasured(f"no members of {a} and {b} on Table {table} went through")
        return Sample(np.array(values))

    def name(self, table: int, motion: str) -> str:
        """(4.13) for a run; exact, with its form where the table has two, for the exact motion."""
        if motion not in FORM_OF:
            return motion
        return f"exact on {FORM_OF[motion]}" if len(self.forms(table)) > 1 else "exact"

    def span(self, table: int) -> str:
        """Length and members of the ensembles of a table, as a text."""
        found = self.tables[table]["span"]
        return (
            f"Table {table}: {found['periods']} drive periods, {len(self.seeds)} × {found['members']} members a "
            f"scheme, {len(self.seeds)} × {found['exact_members']} exact"
        )
