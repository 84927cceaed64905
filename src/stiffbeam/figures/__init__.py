"""Pictures: one look for each method, and the panels that several of them share."""

from .panels import (
    column,
    heading,
    log_scale,
    mark_order,
    new_figure,
    numeric,
    save_figure,
    say_empty,
    shared_legend,
    signed_log,
    tip_name,
    tip_symbol,
)
from .style import COLOURS, DASHES, EXACT, MARKERS, dashed, default_label, look, short

__all__ = [
    "COLOURS", "DASHES", "EXACT", "MARKERS", "column", "dashed", "default_label", "heading", "log_scale", "look",
    "mark_order", "new_figure", "numeric", "save_figure", "say_empty", "shared_legend", "short", "signed_log",
    "tip_name",
    "tip_symbol",
]  # fmt: skip
