"""What methods are called in tables and pictures."""

from __future__ import annotations

from ..basics.validation import InputError
from ..files.cases import parse_run
from ..references.registry import REFERENCES
from ..schemes import Scheme

_SHORT = {
    "bdf2": "BDF2", "sdirk": "SDIRK", "hht": "HHT", "generalised-alpha": "gen.-α", "bathe": "Bathe", "theta": "θ",
    "exponential-flow": "exponential", "moreau-jean": "Moreau-Jean", "moreau-jean-bilbao": "M.-J.-Bilbao",
    "paoli-schatzman": "Paoli-Sch.", "contact-stabilised": "stabilised", "nonsmooth-alpha": "nonsmooth-α",
}  # fmt: skip


def short(label: str) -> str:
    """A method's short name: ``sdirk(gamma=0.4359, nystrom=true)`` is SDIRK(0.4359)."""
    scheme = scheme_of(label)
    if scheme is None:
        return REFERENCES[label].label if label in REFERENCES else label
    values = [f"{v:.4g}" for v in scheme.parameters.values() if not isinstance(v, bool)]
    own = label.partition(":")[2].partition("(")[0]  # the class of a scheme of one's own
    name = (own or _SHORT.get(scheme.name, scheme.name)) + (f"({', '.join(values)})" if values else "")
    return f"{name} printed({scheme.erratum})" if scheme.erratum else name


def scheme_of(label: str) -> Scheme | None:
    """The scheme that a label names, None where it is no scheme's."""
    try:
        return parse_run(label)[0]
    except InputError:
        return None
