"""The natural modes of a system drawn, with frequency and damping ratio."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..basics.validation import integer
from ..model.natural_modes import modes
from ..model.system import System
from .panels import COLOURS, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

POINTS = 200  # along a beam


def mode_shapes(system: System, count: int = 4) -> Figure:
    """The first ``count`` shapes, in any scale: of a beam v(x), of matrices the unknowns in their order.

    A complex shape, of damping that couples the modes, is drawn in its two phases, a quarter of a period apart:
    the part in phase with its largest entry in full, the other dashed.
    """
    natural, units = modes(system), system.units
    count = min(integer("count", count, 1), len(natural.omega))
    figure = new_figure(1.6 * count + 0.4, width=7.0)
    beam = system.problem
    axes = np.ravel(figure.subplots(count, 1, sharex=True, squeeze=False))
    places = [beam.length if s.position is None else float(s.position) for s in beam.all_stops] if beam else []
    for j, axis in enumerate(axes):
        for part, style in ((np.real(natural.shapes[:, j]), "-"), (np.imag(natural.shapes[:, j]), "--")):
            if not np.any(part):
                continue
            if beam is None:
                x, y = np.arange(1, system.size + 1), part
            else:
                x = np.linspace(0.0, beam.length, POINTS)
                still = system.displacement([0.0], np.zeros((1, system.size)), x)  # the base alone
                y = (system.displacement([0.0], part[None], x) - still)[0]
            axis.plot(x, y, style, color=COLOURS[0], marker="" if beam else "o")
        axis.axhline(0.0, color="0.7", lw=0.8)
        for place in places:
            axis.axvline(place, color="0.7", lw=0.8, ls=":")
        omega = units.measure(natural.omega[j], "frequency", ".5g")
        ratio = natural.damping_ratio[j]
        damping = f", damping ratio {ratio:.3g}" if np.isfinite(ratio) and ratio else ""
        axis.set_title(f"mode {j + 1}: $\\omega$ = {omega}{damping}", loc="left", fontsize=9)
        axis.set_yticks([])
    label = "unknown" if beam is None else units.label("place along the beam $x$", "length")
    axes[-1].set_xlabel(f"{label}; dotted: stops" if places else label)
    return figure
