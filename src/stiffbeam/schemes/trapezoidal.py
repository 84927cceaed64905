"""The trapezoidal rule, by name: also Newmark's method with average acceleration, and HHT with alpha = 0."""

from __future__ import annotations

from .theta import Theta


class Trapezoidal(Theta):
    """y^{n+1} = y^n + dt/2 (f^n + f^{n+1}): the theta-method with theta = 1/2.

    Order 2, A-stable. It dissipates no energy on a linear system, and does not damp the highest modes.

    References
    ----------
    Newmark, J. Eng. Mech. Div. ASCE 85 (1959) 67-94, beta = 1/4, gamma = 1/2.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.Trapezoidal()
    Trapezoidal()
    """

    name = "trapezoidal"
    look = (4, 4, 4)

    def __init__(self) -> None:
        super().__init__(0.5)

    @property
    def parameters(self) -> dict[str, float]:
        """None: theta is 1/2."""
        return {}
