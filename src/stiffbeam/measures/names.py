"""Names of methods in tables and pictures."""

from __future__ import annotations

from ..references.registry import REFERENCES
from ..schemes.labels import abbreviated, scheme_of


def short(label: str) -> str:
    """Short name of a method: that of the scheme or of the reference solver; any other label is returned as it is."""
    scheme = scheme_of(label)
    if scheme is not None:
        return abbreviated(scheme, label)
    return REFERENCES[label].label if label in REFERENCES else label
