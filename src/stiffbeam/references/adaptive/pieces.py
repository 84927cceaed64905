"""Smooth intervals of the functions of time, and the longest step in each, so that no step misses a load.

An adaptive solver chooses its steps by the errors that it estimates, and it evaluates a load only at its steps. At rest
it doubles its step and can pass over a short pulse. The time span is therefore cut where a function of time is not
smooth. Inside every interval the step is bounded by the rate at which the functions vary.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...basics.arrays import Array
from ...basics.validation import positive
from ...model.sampled import Sampled
from ...model.system import System
from ...model.time_functions import (
    Harmonic,
    LoadFunction,
    breakpoints_of,
    covered,
    evaluate,
    in_closed_form,
    parts_of,
    times_of,
)
from ..registry import Steps

POINTS = 2**18  # of the first scan of a bare callable: a feature shorter than t_end/2^18 can be missed
MOST_POINTS = 2**22  # where the shortest natural period asks for more
PER_PERIOD = 200  # points per shortest natural period
RESOLVED = 1e-9  # of a function's range: the error of a polynomial of degree 4 in a leaf
LEAVES_PER_STEP = 16  # a leaf is a 50th of a period of a sine
PERIODS_PER_STEP = 0.25  # of a Harmonic
PER_STEP = 0.25  # of a piece with a cubic: it turns twice, and a stop that does is in and out again in one step
ZOOM = 64  # windows of a closer look
SMOOTH_RATIO = 12.0  # by which halving a window must lower its error: 32 where f is smooth, 2 to 4 at a kink
MOST_CUTS = 4096  # a function with more of them is rough everywhere: its steps are bounded, no restarts made
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


class Piece(NamedTuple):
    """Interval [start, end] with smooth functions of time. They may be evaluated in [first, last] only: a jump at an
    end belongs to the neighbour. max_step: inf without a bound."""

    start: float
    end: float
    first: float
    last: float
    max_step: float


class Pieces(NamedTuple):
    """The smooth intervals of [0, t_end] in order; spacing of the scan, 0 if every function is in closed form."""

    pieces: list[Piece]
    spacing: float


def smooth_pieces(system: System, t_end: float, steps: Steps) -> Pieces:
    """Cut [0, t_end] for the loads and contact offsets of ``system``."""
    covered(system.time_functions, t_end)
    # Parts of all functions of time, each once: harmonics, records, and bare callables, which only samples describe.
    functions = {id(part): part for function in system.time_functions for part in parts_of(function)}
    harmonics = [f.frequency for f in functions.values() if isinstance(f, Harmonic) and f.amplitude]
    bare = [f for f in functions.values() if not in_closed_form(f)]
    records = [f for f in functions.values() if isinstance(f, Sampled)]  # polynomials between their samples
    cubic = any(f.kind == "cubic" for f in records)
    # A harmonic load bounds the step too: error control sees a load at the steps only.
    longest = math.inf if steps.max_step is None else positive("max_step", steps.max_step)
    longest = min([longest, *(PERIODS_PER_STEP * 2.0 * math.pi / w for w in harmonics)])
    # Known cuts: breakpoints of the caller, samples of the records, breakpoints that a function states.
    cuts = [(t, t) for t in times_of("breakpoints", steps.breakpoints)]
    cuts += [(t, t) for t in np.unique(np.concatenate([np.zeros(0), *(f.t for f in records)])).tolist()]
    count = _points(system, t_end) if bare else 0
    for f in bare:
        stated = breakpoints_of(f)
        cuts += [(t, t) for t in (() if stated is None else stated)]
    cuts = _joined(cuts, t_end)
    # Unknown cuts: kinks and jumps of every bare callable between the known cuts.
    rough_bound, scans = math.inf, [_Scan(f, t_end, count, steps.other) for f in bare]
    for scan in scans:
        kinks = [scan.rough(start, end) for start, end in _between(cuts, t_end)]
        # No restarts for a function that is rough everywhere: steps of at most one window, eight spacings of the scan.
        if None in kinks or sum(map(len, kinks)) > MOST_CUTS:  # type: ignore[arg-type]
            rough_bound = 8.0 * t_end / count
        else:
            cuts = _joined(cuts + [b for some in kinks for b in some or ()], t_end)
    # Longest step in every interval, by the leaves of the callables, the harmonics and the records.
    edges: list[Piece] = []
    for first, last in _between(cuts, t_end):
        smooth = scans if rough_bound == math.inf else []
        bounds = _bounds([scan.leaves(first, last) for scan in smooth], first, last)
        for start, end, bound in bounds:
            turns = PER_STEP * (end - start) if cubic else math.inf
            edges.append(Piece(start, end, first, last, min(bound, longest, rough_bound, turns)))
    pieces = [
        p._replace(
            start=edges[i - 1].end if i else 0.0,  # the gap of a cut, a few units in the last place, goes to the right
            end=p.end if i + 1 < len(edges) else t_end,
            max_step=GOLDEN**2 * min(p.max_step, t_end / 200.0) if steps.other else p.max_step,
        )
        for i, p in enumerate(edges)
    ]
    return Pieces(pieces, t_end / count if count else 0.0)


def _points(system: System, t_end: float) -> int:
    """Number of points of the scan: POINTS, or more if that is coarse for the shortest natural period."""
    from ...model.modes import undamped_modes

    fastest = float(np.max(undamped_modes(system).omega, initial=0.0))
    return int(min(MOST_POINTS, max(POINTS, PER_PERIOD * t_end * fastest / (2.0 * math.pi))))


def _joined(cuts: list[tuple[float, float]], t_end: float) -> list[tuple[float, float]]:
    """Cuts that reach into [0, t_end] in order, those that touch as one."""
    least = _least(t_end)
    joined: list[tuple[float, float]] = []
    for low, high in sorted(cuts):
        if high < 0.0 or low > t_end:
            continue
        # Cuts that are a few roundings apart would leave an interval of rounding length between them.
        if joined and low <= joined[-1][1] + least:
            joined[-1] = (joined[-1][0], max(joined[-1][1], high))
        else:
            joined.append((low, high))
    return joined


def _least(t_end: float) -> float:
    """Shortest length of an interval."""
    return 64.0 * float(np.finfo(float).eps) * t_end


def _between(cuts: list[tuple[float, float]], t_end: float) -> list[tuple[float, float]]:
    """The open intervals between the cuts, as the first and the last time in each."""
    # The functions may jump at a cut: an interval ends one double before it.
    starts = [0.0] + [math.nextafter(high, math.inf) for _, high in cuts]
    ends = [math.nextafter(low, -math.inf) for low, _ in cuts] + [t_end]
    return [(a, b) for a, b in zip(starts, ends, strict=True) if b - a > _least(t_end)]


def _bounds(leaf_edges: list[Array], start: float, end: float) -> list[tuple[float, float, float]]:
    """(start, end, longest step) of parts of [start, end], given the edges of the leaves of every function.

    Neighbouring leaves of like length make a part; where that is all there is, no bound is needed beyond
    the part's own length.
    """
    if not leaf_edges:
        return [(start, end, math.inf)]
    # Smallest leaf of any function in every elementary interval.
    edges = np.unique(np.concatenate([np.array([start, end]), *leaf_edges]))
    middle = 0.5 * (edges[1:] + edges[:-1])
    size = np.full(len(middle), math.inf)
    for leaves in leaf_edges:
        k = np.clip(np.searchsorted(leaves, middle) - 1, 0, len(leaves) - 2)
        size = np.minimum(size, np.diff(leaves)[k])
    # Leaves of one class, of lengths within a factor of 16, share a part: every further part is one more restart.
    classes = np.floor(np.log2(size) / 4.0)
    breaks = np.flatnonzero(np.diff(classes)) + 1
    # One part with the shortest bound instead of more than 200 restarts.
    if len(breaks) > 200:
        breaks = breaks[:0]
    parts = []
    for a, b in zip(np.append(0, breaks), np.append(breaks, len(size)), strict=True):
        bound = LEAVES_PER_STEP * float(np.min(size[a:b]))
        parts.append((float(edges[a]), float(edges[b]), bound if bound < edges[b] - edges[a] else math.inf))
    return parts


class _Scan:
    """Scan of a function of time by samples: windows of nine, tested at every dyadic scale.

    A window is smooth where the polynomial of degree 4 through every other sample gives those between to
    RESOLVED of the function's range. Leaves are the longest smooth windows all of whose parts are smooth.
    """

    # The weights of samples 0, 2, 4, 6, 8 in the values of their polynomial at 1, 3, 5, 7.
    WEIGHTS = (
        np.array([[35, 140, -70, 28, -5], [-5, 60, 90, -20, 3], [3, -20, 90, 60, -5], [-5, 28, -70, 140, 35]]) / 128.0
    )

    def __init__(self, f: LoadFunction, t_end: float, count: int, other: bool) -> None:
        # A second opinion scans 3 2^k windows: its samples lie at other times and can hit a load that the first missed.
        self.f, self.t_end, self.count, self.odd = f, t_end, count, 3 if other else 1
        values = evaluate(f, np.linspace(0.0, t_end, 4097))
        self.low, self.high = float(np.min(values)), float(np.max(values))

    def rough(self, start: float, end: float) -> list[tuple[float, float]] | None:
        """Narrow brackets of the times in [start, end] where f or f' jumps; None where f is rough all over."""
        # First look: runs of windows in which f is not a polynomial of degree 4.
        t, errors = self._errors(start, end, self._size(start, end))
        bad = np.flatnonzero(errors[0] > self.allowed)
        if len(bad) > len(errors[0]) // 4:
            return None
        # Closer looks, each at the worst windows of the last, until the rounding of time ends them.
        brackets: list[tuple[float, float]] = []
        todo = [(float(t[8 * run[0]]), float(t[8 * run[-1] + 8])) for run in _runs(bad)]
        while todo:
            if len(todo) + len(brackets) > MOST_CUTS:
                return None
            a, b = todo.pop()
            if b - a <= max(1e-14 * self.t_end, 16.0 * np.finfo(float).eps * b):
                brackets.append((a, b))
                continue
            t, errors = self._errors(a, b, ZOOM)
            largest = np.array([np.max(e) for e in errors[::-1]])  # from the whole of [a, b] to its smallest windows
            # seen: number of levels from the coarsest to the finest whose error exceeds the rounding of the samples.
            seen = len(largest) - int(np.argmax(largest[::-1] > 0.03 * self.rounding))
            if not np.any(largest > 0.03 * self.rounding):
                brackets.append((a, b))  # a jump as narrow as rounding lets it be seen
            # A kink, or too few levels to judge. A faster fall of the error shows a smooth f: the run is then dropped.
            elif seen < 2 or largest[seen - 2] < SMOOTH_RATIO * largest[seen - 1]:
                fine = errors[len(errors) - seen]
                windows = np.flatnonzero(fine > 0.1 * np.max(fine))
                width = 8 * ZOOM >> (seen - 1)
                todo += [(float(t[width * run[0]]), float(t[width * (run[-1] + 1)])) for run in _runs(windows)]
                # The look did not narrow the bracket; looked at again, it would not end.
                if todo[-1][1] - todo[-1][0] > 0.9 * (b - a):
                    brackets.append(todo.pop())
        return brackets

    def leaves(self, start: float, end: float) -> Array:
        """The edges of the leaves in [start, end]; what the first samples do not resolve is looked at closer."""
        edges = [np.array([start, end])]
        todo = [(start, end, self._size(start, end), 0)]
        while todo and len(edges) < MOST_CUTS:
            a, b, size, depth = todo.pop()
            t, smooth = self._smooth(a, b, size)
            leaf_edges, covered = [], np.zeros(size, bool)
            # From the longest windows to the shortest: a window is a leaf if no longer one covers it.
            for level in range(len(smooth) - 1, -1, -1):
                width = 2**level
                new = np.flatnonzero(smooth[level] & ~covered[::width])
                leaf_edges += [t[8 * width * new], t[8 * width * (new + 1)]]
                for k in new:
                    covered[k * width : (k + 1) * width] = True
            # The finest windows that are not smooth are leaves as well, and are divided up to four times.
            bad = np.flatnonzero(~covered)
            leaf_edges += [t[8 * bad], t[8 * bad + 8]]
            if depth < 4:
                todo += [(float(t[8 * k]), float(t[8 * k + 8]), 64, depth + 1) for k in bad]
            edges.append(np.concatenate(leaf_edges))
        return np.unique(np.concatenate(edges))

    def _size(self, start: float, end: float) -> int:
        """The number of finest windows in a first look at [start, end]: 2^k, or 3 2^k, whose points are others."""
        share = self.count * (end - start) / self.t_end / 8.0 / self.odd
        return self.odd * 2 ** max(6, math.ceil(math.log2(max(share, 1.0))))

    @property
    def rounding(self) -> float:
        """Bound of the rounding of the samples."""
        return 1e3 * np.finfo(float).eps * max(abs(self.low), abs(self.high))

    @property
    def allowed(self) -> float:
        return max(RESOLVED * (self.high - self.low), self.rounding)

    def _smooth(self, a: float, b: float, size: int) -> tuple[Array, list[Array]]:
        """The samples' times, and of every level which windows are smooth, the finest of ``size`` first."""
        t, errors = self._errors(a, b, size)
        smooth: list[Array] = []
        for error in errors:
            good = error <= self.allowed
            smooth.append(good & smooth[-1][::2] & smooth[-1][1::2] if smooth else good)
        return t, smooth

    def _errors(self, a: float, b: float, size: int) -> tuple[Array, list[Array]]:
        """The samples' times, and of every level the error in each window, the finest of ``size`` first."""
        t = np.linspace(a, b, 8 * size + 1)
        values = evaluate(self.f, t)
        self.low, self.high = min(self.low, float(np.min(values))), max(self.high, float(np.max(values)))
        levels: list[Array] = []
        for level in range((size & -size).bit_length()):  # as often as size can be halved
            stride, windows = 2**level, size >> level
            # Half a window apart, so that a kink at the edge of two windows is inside one between them.
            last = 4 * stride * (2 * windows - 2) + 1
            nodes = np.stack([values[k * stride : k * stride + last : 4 * stride] for k in range(9)])
            error = np.max(np.abs(self.WEIGHTS @ nodes[::2] - nodes[1::2]), axis=0)
            # Every window takes the errors of the two that straddle its edges.
            errors, between = error[::2].copy(), error[1::2]
            np.maximum(errors[:-1], between, out=errors[:-1])
            np.maximum(errors[1:], between, out=errors[1:])
            levels.append(errors)
        return t, levels


def _runs(indices: Array) -> list[Array]:
    """The runs of consecutive numbers in a sorted array."""
    return np.split(indices, np.flatnonzero(np.diff(indices) > 1) + 1) if len(indices) else []
