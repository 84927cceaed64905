"""Which starts does a scheme send to the wrong motion?

    python studies/how-to/basins.py                # prints the table, two minutes
    python studies/how-to/basins.py --out .        # writes basins.png too

A driven mass with a stop has two attractors: a motion that misses the stop, and one that hits it in every second
period. Where a motion ends depends on its start. The script follows a grid of starts by the exact solution and by
schemes. Each ends on the one attractor or the other, since it hits the stop in the last periods or does not. The table
has the share of starts that end on another attractor than the exact motion does.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

import stiffbeam as sb

FREQUENCY, PERIODS, LAST = 2.6, 150, 4  # of the drive; periods in all, and those in which impacts decide
METHODS: tuple[tuple[sb.Scheme, str], ...] = (
    (sb.HHT(alpha=-0.1), "implicit"),
    (sb.HHT(alpha=-0.1), "extrapolated"),
    (sb.BDF2(), "implicit"),
    (sb.SDIRK(), "implicit"),
    (sb.Trapezoidal(), "implicit"),
    (sb.Trapezoidal(), "conserving"),
    (sb.ExponentialFlow(), "conserving"),
)
COLOURS = {
    "ends without impacts": "white",
    "ends with impacts": "0.45",
    "wrong: without": "#fdb863",
    "wrong: with": "#b35806",
}
PLACES, SPEEDS = (-3.0, 0.5), (-3.0, 3.0)


def starts(side: int) -> sb.EnsembleMembers:
    """The driven mass from a square grid of ``side`` initial positions and as many velocities."""
    load = ([1.0], sb.Harmonic(amplitude=0.7, frequency=FREQUENCY))
    stop = sb.Contact(np.ones(1), sb.Stops(upper=PLACES[1], stiffness=100.0))
    system = sb.System.from_matrices([[1.0]], [[1.0]], [[0.08]], loads=[load], contacts=[stop])
    places, speeds = np.meshgrid(np.linspace(*PLACES, side), np.linspace(*SPEEDS, side))
    return sb.varied_members(system, {"initial_displacement[0]": places, "initial_velocity[0]": speeds})


def exact(members: sb.EnsembleMembers) -> NDArray[np.bool_]:
    """True for members whose exact motion hits the stop in the last periods."""
    end, since = 2.0 * np.pi / FREQUENCY * np.array([PERIODS, PERIODS - LAST])
    return sb.reference_ensemble(members.system, end, members, since=since).impact_count > 0


def computed(members: sb.EnsembleMembers, scheme: sb.Scheme, contact: str, steps: int) -> NDArray[np.bool_]:
    """The same for a scheme with so many steps in a period."""
    period = 2.0 * np.pi / FREQUENCY
    runs = sb.integrate_ensemble(
        members.system, scheme, period / steps, PERIODS * period, members, contact=contact,
        since=(PERIODS - LAST) * period,
    )  # fmt: skip
    return runs.impact_count > 0


def picture(side: int, hits: dict[str, NDArray[np.bool_]], steps: int) -> Figure:
    """Return the starts by where they end; the first of ``hits`` is the exact one."""
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    truth = next(iter(hits.values()))
    for axis, (name, ends) in zip(figure.subplots(1, len(hits), sharey=True), hits.items(), strict=True):
        colours = np.where(ends == truth, ends, ends + 2).reshape(side, side)
        axis.imshow(
            colours, origin="lower", extent=(*PLACES, *SPEEDS), aspect="auto", interpolation="nearest",
            cmap=ListedColormap(list(COLOURS.values())), vmin=-0.5, vmax=3.5,
        )  # fmt: skip
        axis.set_title(name if ends is truth else f"{name}, {steps} steps a period", fontsize=11)
        axis.set_xlabel("initial position")
    figure.axes[0].set_ylabel("initial velocity")
    handles = [Patch(facecolor=colour, edgecolor="black", label=label) for label, colour in COLOURS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    shares = [f"{name} {np.mean(ends != truth):.0%}" for name, ends in list(hits.items())[1:]]
    figure.suptitle(f"Starts that end on the wrong motion: {', '.join(shares)}")
    return figure


def main() -> None:
    """Print the table, and draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--side", type=int, default=60, help="starts along each side of the grid")
    parser.add_argument("--steps", type=int, nargs="+", default=[50, 100, 200, 400], help="in a period of the drive")
    parser.add_argument("--out", type=Path, help="folder for basins.png")
    arguments = parser.parse_args()
    members = starts(arguments.side)
    truth = exact(members)
    print(f"{len(members)} starts, of which {np.mean(truth):.1%} end on the motion that hits the stop")
    print("share of starts that end on the wrong motion, in brackets that end on the one with impacts")
    print(f"{'steps in a period':33}" + "".join(f"{steps:>17d}" for steps in arguments.steps))
    shown = {"exact": truth}
    for scheme, contact in METHODS:
        line = f"{scheme!s:20} {contact:12}"
        for steps in arguments.steps:
            ends = computed(members, scheme, contact, steps)
            line += f"{np.mean(ends != truth):9.2%} ({np.mean(ends):.1%})"
            if steps == arguments.steps[0] and contact == "implicit" and len(shown) < 3:
                shown[f"{scheme}"] = ends
        print(line, flush=True)
    if arguments.out is not None:
        picture(arguments.side, shown, arguments.steps[0]).savefig(arguments.out / "basins.png", dpi=100)


if __name__ == "__main__":
    main()
