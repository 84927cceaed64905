"""One look for each method, by its name alone: no place in a registry changes it."""

from __future__ import annotations

from typing import Any
from zlib import crc32

from ..measures.names import short
from ..references.registry import REFERENCES
from ..schemes import RIGID, SCHEMES, make
from ..schemes.labels import scheme_of

# Okabe and Ito's palette, distinguishable with any colour vision, and two more; black is the exact motion.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#5E3C99", "#7F5A1D")
# Thirteen, one for each scheme of the package, so that they can be told apart in grey.
DASHES = (
    (), (5, 1.5), (1.5, 1.2), (6, 1.5, 1.5, 1.5), (3, 1), (8, 2), (1, 3), (6, 1.5, 1.5, 1.5, 1.5, 1.5),
    (4, 4), (10, 2, 3, 2), (3, 1, 1, 1, 1, 1, 1, 1), (8, 5), (3, 3, 1, 3),
)  # fmt: skip
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
EXACT = ("exact", "multiprecision", "reference", "tangent flow")  # what stands for the exact motion
# Colour, dashes and marker of the schemes that state them; any other name takes one of the free pairs.
LOOKS = {name: scheme.look for name, scheme in (SCHEMES | RIGID).items() if scheme.look is not None}
_TAKEN = {(dashes, marker) for _, dashes, marker in LOOKS.values()}
_FREE = [(d, m) for d in range(len(DASHES)) for m in range(len(MARKERS)) if (d, m) not in _TAKEN]


def look(label: str) -> dict[str, Any]:
    """Colour, dashes and marker of a method, the same in every picture; arguments of ``Axes.plot``.

    The exact motion is black. A scheme has its colour by name; other parameters than its default's change
    dashes and marker. The Nyström form of SDIRK-OS is the same scheme and looks the same. Other solvers are
    grey, a user's own scheme has a colour chosen by its label.
    """
    if label in EXACT:
        return {"color": "black", "linestyle": "-", "marker": "*"}
    if label in REFERENCES:
        k = REFERENCES[label].look
        return {"color": ("0.6", "0.3")[k % 2], "linestyle": dashed(k), "marker": MARKERS[k % len(MARKERS)]}
    scheme = scheme_of(label)
    # A class of one's own may have kept the name of the one it is made from.
    known = None if scheme is None or ":" in label else scheme.name
    colour, dashes, marker = look_of_name(known or label)
    other = 0
    if known and short(label) != short(known):
        pairs = len(DASHES) * len(MARKERS)  # coprime, so that every shift is another pair
        other = 1 + crc32(short(label).encode()) % (pairs - 1)
    return {
        "color": COLOURS[colour],
        "linestyle": dashed(dashes + other),
        "marker": MARKERS[(marker + other) % len(MARKERS)],
    }


def look_of_name(name: str) -> tuple[int, int, int]:
    """(colour, dashes, marker) of a scheme by its name: those in LOOKS, else chosen by the name's checksum."""
    if name in LOOKS:
        return LOOKS[name]
    rest, colour = divmod(crc32(name.encode()), len(COLOURS))
    return colour, *_FREE[rest % len(_FREE)]


def dashed(i: int) -> Any:
    """The i-th line style of the palette."""
    dashes = DASHES[i % len(DASHES)]
    return (0, dashes) if dashes else "-"


def default_label(name: str) -> str:
    """The label of a registered scheme with its default parameters."""
    return str(make(name))
