"""The schemes. A new one is one file, and one line here and in the list of public names."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .first_order_form import BDF2, Bathe, ExponentialFlow, Theta, Trapezoidal
from .newmark import HHT, GeneralisedAlpha, UnweightedHHT
from .rigid import ContactStabilisedNewmark, MoreauJean, NonsmoothGeneralisedAlpha, PaoliSchatzman, RigidScheme
from .rigid import takes_stops as takes_stops
from .scheme import Scheme
from .sdirk import GAMMA_THIRD_ORDER as GAMMA_THIRD_ORDER
from .sdirk import SDIRK, PrintedSigma, PrintedStageMatrix

if TYPE_CHECKING:
    from collections.abc import Iterator

SCHEMES: dict[str, type[Scheme]] = {
    scheme.__name__: scheme
    for scheme in (BDF2, SDIRK, HHT, GeneralisedAlpha, Trapezoidal, Bathe, Theta, ExponentialFlow)
}

# For stops with stiffness=inf, and for these alone.
RIGID: dict[str, type[RigidScheme]] = {
    scheme.__name__: scheme
    for scheme in (MoreauJean, PaoliSchatzman, ContactStabilisedNewmark, NonsmoothGeneralisedAlpha)
}

# With the misprints of the paper, which have labels as any other.
ALL: dict[str, type[Scheme]] = (
    SCHEMES | RIGID | {scheme.__name__: scheme for scheme in (UnweightedHHT, PrintedSigma, PrintedStageMatrix)}
)


def registered() -> Iterator[Scheme]:
    """Every registered scheme: its defaults, then its variants."""
    for scheme in SCHEMES.values():
        for parameters in ({}, *scheme.variants):
            yield scheme(**parameters)
