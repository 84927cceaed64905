"""Generalised-alpha: the least dissipative of its family for a given damping at high frequencies."""

from __future__ import annotations

from .newmark import WeightedNewmark
from .scheme import in_interval


class GeneralisedAlpha(WeightedNewmark):
    """The weighted Newmark step with, for a spectral radius rho at infinite frequency,

        alpha_m = (2 rho - 1)/(rho + 1),    beta  = (1 - alpha_m + alpha_f)^2/4,
        alpha_f = rho/(rho + 1),            gamma = 1/2 - alpha_m + alpha_f.

    Order 2, A-stable. The weights fall on the old values, as in Chung and Hulbert. HHT is alpha_m = 0 and
    alpha_f = -alpha.

    Parameters
    ----------
    rho : float
        In [0, 1]: 1 dissipates no energy on a linear system, 0 removes the highest modes in one step.

    Raises
    ------
    InputError
        For any other rho.

    References
    ----------
    Chung and Hulbert, J. Appl. Mech. 60 (1993) 371-375, (25)-(27).

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.GeneralisedAlpha(rho=0.8)
    GeneralisedAlpha(rho=0.8)
    """

    name = "generalised-alpha"
    look = (3, 3, 3)
    variants = ({"rho": 0.0}, {"rho": 1.0})

    def __init__(self, rho: float = 0.8) -> None:
        self.rho = in_interval("rho", rho, 0.0, 1.0)
        self.alpha_m = (2.0 * self.rho - 1.0) / (self.rho + 1.0)
        self.alpha_f = self.rho / (self.rho + 1.0)
        self.beta = (1.0 - self.alpha_m + self.alpha_f) ** 2 / 4.0
        self.gamma = 0.5 - self.alpha_m + self.alpha_f

    @property
    def parameters(self) -> dict[str, float]:
        """The spectral radius ``rho`` at infinite frequency."""
        return {"rho": self.rho}
