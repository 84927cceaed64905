"""Multiples and sums of functions of time in one gap: the moving support and the moving stop."""

from __future__ import annotations

from .time_functions import Constant, Harmonic, LoadFunction, Sum


def combined(*terms: tuple[float, LoadFunction | None]) -> LoadFunction | None:
    """sum_k factor_k f_k, None for nothing; a multiple of one Harmonic or Constant is one again."""
    kept = tuple((float(factor), f) for factor, f in terms if f is not None and factor != 0.0)
    if not kept:
        return None
    factor, f = kept[0]
    if len(kept) == 1 and isinstance(f, Harmonic):
        return Harmonic(factor * f.amplitude, f.frequency, f.phase)
    if all(isinstance(f, Constant) for _, f in kept):
        return Constant(sum(factor * f.level for factor, f in kept if isinstance(f, Constant)))
    return f if len(kept) == 1 and factor == 1.0 else Sum.weighted(kept)
