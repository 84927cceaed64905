"""Pictures: one look for each method, and the panels that several of them share."""

from .panels import (
    COLOURS,
    DASHES,
    EXACT,
    MARKERS,
    column,
    dashed,
    default_label,
    heading,
    log_scale,
    look,
    mark_order,
    new_figure,
    numeric,
    save_figure,
    say_empty,
    shared_legend,
    short,
    signed_log,
    tip_name,
    tip_symbol,
)

__all__ = [
    "COLOURS", "DASHES", "EXACT", "MARKERS", "column", "dashed", "default_label", "heading", "log_scale", "look",
    "mark_order", "new_figure", "numeric", "save_figure", "say_empty", "shared_legend", "short", "signed_log",
    "tip_name",
    "tip_symbol",
]  # fmt: skip
