"""The schemes. A new one is one file, and one line here and in the list of public names."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .bathe import Bathe as Bathe
from .bdf2 import BDF2 as BDF2
from .conserving import ExponentialFlow as ExponentialFlow
from .conserving import Theta as Theta
from .conserving import Trapezoidal as Trapezoidal
from .misprints import PrintedSigma as PrintedSigma
from .misprints import PrintedStageMatrix as PrintedStageMatrix
from .misprints import UnweightedHHT as UnweightedHHT
from .newmark import HHT as HHT
from .newmark import GeneralisedAlpha as GeneralisedAlpha
from .rigid import ContactStabilisedNewmark as ContactStabilisedNewmark
from .rigid import MoreauJean as MoreauJean
from .rigid import NonsmoothGeneralisedAlpha as NonsmoothGeneralisedAlpha
from .rigid import PaoliSchatzman as PaoliSchatzman
from .rigid import RigidScheme as RigidScheme
from .rigid import takes_stops as takes_stops
from .scheme import Scheme as Scheme
from .sdirk import GAMMA_THIRD_ORDER as GAMMA_THIRD_ORDER
from .sdirk import SDIRK as SDIRK

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
