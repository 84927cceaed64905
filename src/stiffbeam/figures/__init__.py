"""Pictures: one look for each method, the chart that a study declares, and panels that several pictures share."""

from .chart import (
    Axis,
    Band,
    Curve,
    Level,
    Map,
    Mark,
    Note,
    Panel,
    Picture,
    Ranges,
    curves,
    groups,
    render,
    style_of,
)
from .panels import (
    COLOURS,
    EXACT,
    MARKERS,
    column,
    dashed,
    default_label,
    heading,
    look,
    new_figure,
    numeric,
    save_figure,
    short,
    tip_name,
    tip_symbol,
    with_nan,
)

__all__ = [
    "COLOURS", "EXACT", "MARKERS", "Axis", "Band", "Curve", "Level", "Map", "Mark", "Note", "Panel", "Picture",
    "Ranges", "column", "curves", "dashed", "default_label", "groups", "heading", "look", "new_figure", "numeric",
    "render", "save_figure", "short", "style_of", "tip_name", "tip_symbol",
    "with_nan",
]  # fmt: skip
