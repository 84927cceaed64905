"""Reading of the paper where it is silent or in error."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stiffbeam.basics.validation import InputError, one_of
from stiffbeam.march.treatment import TREATMENTS
from stiffbeam.schemes import Scheme
from stiffbeam.schemes.misprints import forms_of


@dataclass(frozen=True)
class Reading:
    """contact: implicit, or extrapolated as the paper describes it. printed: HHT and SDIRK with the misprint
    that runs at any step ((4.13) unweighted, the sign of sigma); BDF2 has none. references: the folder of
    frozen multiprecision solutions, None for the exact solution in float64.
    """

    contact: str = "implicit"
    printed: bool = False
    references: str | None = None

    def __post_init__(self) -> None:
        one_of("contact", self.contact, TREATMENTS)

    def scheme(self, scheme: Scheme) -> Scheme:
        """``scheme`` as this reading has it."""
        return scheme.printed() if self.printed and forms_of(scheme) else scheme

    @property
    def name(self) -> str:
        """For folders: ``implicit-corrected``, ``extrapolated-printed``, ..."""
        return f"{self.contact}-{'printed' if self.printed else 'corrected'}"

    def to_dict(self) -> dict[str, Any]:
        """Entries that tell a finished table of this reading from others."""
        return {"contact": self.contact, "printed": self.printed, "references": self.references}


def reading(contact: str, printed: bool, references: Path | None) -> Reading:
    """A Reading whose references are ``references``, or those that are there, see ``shipped``."""
    from stiffbeam.studies.references import MANIFEST, shipped

    if references is not None and not (references / MANIFEST).is_file():
        raise InputError("--references", str(references), f"hold a {MANIFEST}", "make it with stiffbeam reference")
    folder = references if references is not None else shipped()
    return Reading(contact, printed, None if folder is None else str(folder.resolve()))
