"""HHT-alpha: Newmark's updates with the weighted equation of motion of Hilber, Hughes and Taylor."""

from __future__ import annotations

from .newmark import WeightedNewmark
from .scheme import in_interval


class HHT(WeightedNewmark):
    """M a^{n+1} = (1 + alpha) N^{n+1} - alpha N^n,  N = f - C q' - K q (loads and contact included),

        q^{n+1} = q^n + dt v^n + dt^2 [(1/2 - beta) a^n + beta a^{n+1}],    beta = (1 - alpha)^2/4,
        v^{n+1} = v^n + dt [(1 - gamma) a^n + gamma a^{n+1}],               gamma = 1/2 - alpha.      (4.13)

    The weighted Newmark step with alpha_m = 0 and alpha_f = -alpha. Order 2, A-stable. The contact enters as
    (1 + alpha) sigma(v^{n+1}) - alpha sigma(v^n). The order drops to 1 where the acceleration is computed again from
    M a = N in each step, and where a force is left out of the weighting as the paper prints (``Scheme.printed``).

    Parameters
    ----------
    alpha : float
        In [-1/3, 0]; 0 is the trapezoidal rule. Other packages write alpha_H = -alpha in [0, 1/3], or 1 + alpha in
        [2/3, 1].

    Raises
    ------
    InputError
        For any other alpha.

    References
    ----------
    Dumont (2002), (4.13); Hilber, Hughes and Taylor, Earthquake Eng. Struct. Dyn. 5 (1977) 283-292.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.HHT(alpha=-0.1)
    HHT(alpha=-0.1)
    """

    name = "hht"
    paper = "(4.13)"
    look = (2, 2, 2)
    variants = ({"alpha": 0.0}, {"alpha": -0.3})

    def __init__(self, alpha: float = -0.1) -> None:
        self.alpha = in_interval(
            "alpha", alpha, -1.0 / 3.0, 0.0, "if your alpha is in [0, 1/3], pass -alpha; if in [2/3, 1], alpha - 1"
        )
        self.alpha_m, self.alpha_f = 0.0, -self.alpha
        self.beta = (1.0 - self.alpha) ** 2 / 4.0
        self.gamma = 0.5 - self.alpha

    @property
    def parameters(self) -> dict[str, float]:
        """``alpha`` in the paper's sign, in [-1/3, 0]."""
        return {"alpha": self.alpha}
