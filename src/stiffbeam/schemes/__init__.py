"""The schemes, one file each, and their registry. A new scheme is one file and one line here."""

from __future__ import annotations

from collections.abc import Iterator
from inspect import signature
from typing import Any

from ..basics.validation import InputError, near
from . import misprints as misprints  # which makes the printed forms known
from .bathe import Bathe
from .bdf2 import BDF2
from .contact_stabilised import ContactStabilisedNewmark
from .exponential_flow import ExponentialFlow
from .generalised_alpha import GeneralisedAlpha
from .hht import HHT
from .moreau_jean import MoreauJean
from .moreau_jean_bilbao import MoreauJeanBilbao
from .nonsmooth_alpha import NonsmoothGeneralisedAlpha
from .own import own_class
from .paoli_schatzman import PaoliSchatzman
from .rigid_scheme import RigidScheme, takes_stops
from .scheme import Scheme
from .sdirk import GAMMA_THIRD_ORDER, SDIRK
from .theta import Theta
from .trapezoidal import Trapezoidal

SCHEMES: dict[str, type[Scheme]] = {
    scheme.name: scheme for scheme in (BDF2, SDIRK, HHT, GeneralisedAlpha, Trapezoidal, Bathe, Theta, ExponentialFlow)
}

# For stops with stiffness=inf only; every one of SCHEMES takes these too.
RIGID: dict[str, type[RigidScheme]] = {
    scheme.name: scheme
    for scheme in (MoreauJean, PaoliSchatzman, ContactStabilisedNewmark, NonsmoothGeneralisedAlpha, MoreauJeanBilbao)
}

# The parameter sets that tests and studies run beside each scheme's defaults.
_VARIANTS: dict[str, list[dict[str, Any]]] = {
    "sdirk": [{"nystrom": True}, {"gamma": 1.0}, {"gamma": 1.0, "nystrom": True}],
    "hht": [{"alpha": 0.0}, {"alpha": -0.3}],
    "generalised-alpha": [{"rho": 0.0}, {"rho": 1.0}],
    "bathe": [{"split": 2.0 - 2.0**0.5}],
}


def make(name: str, **parameters: Any) -> Scheme:
    """The registered scheme ``name``, or the one that ``module:Class`` names, with its parameters."""
    known = SCHEMES | RIGID
    if name not in known and ":" not in name:
        raise InputError("scheme", name, "be a registered scheme", near(name, known))
    kind = known.get(name) or own_class(name)
    own = [p for p in signature(kind).parameters if p not in ("args", "kwargs")]
    for parameter in parameters:
        if parameter not in own:
            remedy = near(parameter, own) if own else "it has none"
            raise InputError(f"{name}'s parameter", parameter, "be one of its own", remedy)
    return kind(**parameters)


def registered() -> Iterator[Scheme]:
    """Every registered scheme: its defaults, then its variants."""
    for name in SCHEMES:
        for parameters in [{}, *_VARIANTS.get(name, [])]:
            yield make(name, **parameters)


__all__ = [
    "BDF2",
    "GAMMA_THIRD_ORDER",
    "HHT",
    "RIGID",
    "SCHEMES",
    "SDIRK",
    "Bathe",
    "ContactStabilisedNewmark",
    "ExponentialFlow",
    "GeneralisedAlpha",
    "MoreauJean",
    "MoreauJeanBilbao",
    "NonsmoothGeneralisedAlpha",
    "PaoliSchatzman",
    "RigidScheme",
    "Scheme",
    "Theta",
    "Trapezoidal",
    "make",
    "registered",
    "takes_stops",
]
