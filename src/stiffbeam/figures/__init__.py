"""Pictures: one palette, one way to write a file, one module per kind of picture."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

# Okabe and Ito's palette, distinguishable with any colour vision; black is the reference.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
DASHES = ((), (5, 1.5), (1.5, 1.2), (6, 1.5, 1.5, 1.5), (3, 1), (8, 2))


def save_figure(figure: Figure, file: str | Path) -> Path:
    """Write PNG (200 dpi) or SVG by the file's ending."""
    path = Path(file)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=200)
    return path
