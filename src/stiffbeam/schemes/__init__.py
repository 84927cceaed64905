"""The schemes, one file each, and the text that names them."""

from . import misprints as misprints  # registers the printed forms
from .labels import make as make
from .labels import registered as registered
from .registry import *  # noqa: F403
from .registry import RIGID as RIGID
from .registry import SCHEMES as SCHEMES
from .scheme import takes_stops as takes_stops
from .sdirk import GAMMA_THIRD_ORDER as GAMMA_THIRD_ORDER
