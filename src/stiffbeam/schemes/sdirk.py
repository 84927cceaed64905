"""SDIRK-OS: the three-stage singly diagonally implicit Runge-Kutta family of Owren and Simonsen."""

from __future__ import annotations

import warnings

import numpy as np

from ..basics.validation import InputError, number
from .scheme import Array, Equation, Scheme, Step, oscillator

# The middle root of 1/6 - (3/2) g + 3 g^2 - g^3, nearest double: third order.
GAMMA_THIRD_ORDER = 0.435866521508459
# The two real roots between which R(z) is L-stable: 24 g^4 - 72 g^3 + 48 g^2 - 12 g + 1 (p. 61).
GAMMA_MIN, GAMMA_MAX = 0.1804253064293986, 2.185600097355037
COEFFICIENT_LIMIT = 1e3


class SDIRK(Scheme):
    """K_i = f(t^n + c_i dt, y^n + dt sum_{j<=i} a_ij K_j),  y^{n+1} = y^n + dt sum b_i K_i, with

        gamma        | gamma
        gamma+sigma  | sigma   gamma                b2 = (gamma^2 - 2 gamma + 1/2)/sigma
        1            | b1      b2      gamma        b1 = 1 - gamma - b2                        (4.8), (4.9)

        sigma = -(gamma^3 - 3 gamma^2 + 2 gamma - 1/3)/(gamma^2 - 2 gamma + 1/2)

    Stiffly accurate and L-stable; order 3 for the default gamma, the paper's 0.4359, else 2. The paper prints sigma
    without its minus sign, which costs an order: ``PrintedSigma``. State: y.

    Parameters
    ----------
    gamma : float
        In [0.18043, 2.18560], but not where sigma vanishes or has its pole (a coefficient beyond 1e3, near 0.25777,
        0.29289 and 0.60507). gamma > 1 and gamma in (0.2929, 1/3) put nodes beyond the step (Remark 8).
    nystrom : bool
        False solves for the rates K_i of y = (q, q'), or of a first-order y: (4.10) and (4.12). True solves for the
        accelerations alone, with Abar = A A and Bbar = b^T A: (4.14), on second-order systems. The two are equal.

    References
    ----------
    Dumont (2002), (4.7)-(4.14); Owren and Simonsen, Comput. Methods Appl. Mech. Eng. 122 (1995) 1-10.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.SDIRK().nodes[0]
    0.435866521508459
    """

    look = (1, 1, 1)
    variants = ({"nystrom": True}, {"gamma": 1.0}, {"gamma": 1.0, "nystrom": True})

    def __init__(self, gamma: float = GAMMA_THIRD_ORDER, nystrom: bool = False) -> None:
        gamma = number("gamma", gamma, least=GAMMA_MIN, most=GAMMA_MAX, remedy="outside it the scheme is not L-stable")
        # The paper's four digits mean the root.
        self.gamma = GAMMA_THIRD_ORDER if gamma == 0.4359 else gamma  # as the paper prints it
        if not isinstance(nystrom, (bool, np.bool_)):
            raise InputError("nystrom", nystrom, "be True or False", "for example nystrom=True")
        self.nystrom = bool(nystrom)
        self.order = 3 if self.gamma == GAMMA_THIRD_ORDER else 2
        g, s = self.gamma, self.sigma
        b2 = (g**2 - 2.0 * g + 0.5) / s if s else np.inf
        self.A = np.array([[g, 0.0, 0.0], [s, g, 0.0], [1.0 - g - b2, b2, g]])
        if not np.all(np.abs(self.A) <= COEFFICIENT_LIMIT):
            raise InputError("gamma", gamma, f"give coefficients below {COEFFICIENT_LIMIT:g}", "move gamma by 0.01")
        self.b = self.A[2]
        self.nodes = (g, g + s, 1.0)
        if max(self.nodes) > 1.0:
            where = f"{max(self.nodes):.3g} dt, beyond the step (Remark 8)"
            warnings.warn(f"gamma = {g:g} evaluates forces at {where}", stacklevel=2)

    @property
    def sigma(self) -> float:
        """The tableau's sigma (not the contact force), corrected: the paper prints the opposite sign."""
        g = self.gamma
        denominator = g**2 - 2.0 * g + 0.5
        return -(g**3 - 3.0 * g**2 + 2.0 * g - 1.0 / 3.0) / denominator if denominator else np.inf

    @property
    def Abar(self) -> np.ndarray:
        """The Nystroem matrix A A: weights of the accelerations in the stage positions, over dt^2."""
        return self.A @ self.A

    @property
    def parameters(self) -> dict[str, float]:
        """gamma, as 0.4359 where it is the root of order 3, and nystrom where it is true."""
        gamma = 0.4359 if self.gamma == GAMMA_THIRD_ORDER else self.gamma
        return {"gamma": gamma} | ({"nystrom": True} if self.nystrom else {})

    def characteristic(self, x: float, xi: float) -> Array | None:
        """Degree 1: the root is R(z) = ((3 g^2 - 3 g + 1/2) z^2 - (3 g - 1) z + 1)/(1 - g z)^3."""
        z, g = oscillator(x, xi), self.gamma
        return np.array([(1.0 - g * z) ** 3, -((3.0 * g**2 - 3.0 * g + 0.5) * z**2 - (3.0 * g - 1.0) * z + 1.0)])

    def step(self, equation: Equation, dt: float, z: Array, loads: list[Array], reactions: list[Array]) -> Step:
        """Three implicit stages with one matrix; the force of stage i acts at node i."""
        forces = [load + reaction for load, reaction in zip(loads, reactions, strict=True)]
        return (self._step_nystrom if self.nystrom else self._step_rates)(equation, dt, z, forces)

    def _step_rates(self, equation: Equation, dt: float, y: Array, forces: list[Array]) -> Step:
        rates, stages = [], []
        for a, force in zip(self.A, forces, strict=True):
            r = y + dt * sum(a_j * k for a_j, k in zip(a, rates, strict=False))
            rates.append(equation.implicit_rate(self.gamma * dt, r, force))
            stages.append(r + self.gamma * dt * rates[-1])
        return y + dt * sum(b * k for b, k in zip(self.b, rates, strict=True)), stages

    def _step_nystrom(self, equation: Equation, dt: float, z: Array, forces: list[Array]) -> Step:
        q, v = z
        implicit = self.gamma * dt
        accelerations, stages = [], []
        for c, a, abar, force in zip(self.nodes, self.A, self.Abar, forces, strict=True):
            # Stage values without the stage's own acceleration.
            q_i = q + c * dt * v + dt**2 * sum(w * k for w, k in zip(abar, accelerations, strict=False))
            v_i = v + dt * sum(w * k for w, k in zip(a, accelerations, strict=False))
            k = equation.solve(implicit, implicit**2, equation.net_force(np.array([q_i, v_i]), force))
            accelerations.append(k)
            stages.append(np.array([q_i + implicit**2 * k, v_i + implicit * k]))
        q_new = q + dt * v + dt**2 * sum(w * k for w, k in zip(self.b @ self.A, accelerations, strict=True))
        v_new = v + dt * sum(w * k for w, k in zip(self.b, accelerations, strict=True))
        return np.array([q_new, v_new]), stages


class PrintedSigma(SDIRK):
    """(4.9) with the printed sign of sigma: order 2 instead of 3 at gamma = 0.4359."""

    def __init__(self, gamma: float = GAMMA_THIRD_ORDER, nystrom: bool = False) -> None:
        super().__init__(gamma, nystrom)
        self.order = 2

    @property
    def sigma(self) -> float:
        """The tableau's sigma with the sign as printed."""
        return -super().sigma


class PrintedStageMatrix(SDIRK):
    """(4.14) with the printed stage matrix: off-diagonal sigma, gamma^2 b1, gamma^2 b2 for those of A A.

    Order 2. Its spectral radius exceeds 1 at every step, by (omega dt)^4/310 for small ones at gamma = 0.4359: every
    mode grows, and most systems overflow.
    """

    def __init__(self, gamma: float = GAMMA_THIRD_ORDER, nystrom: bool = True) -> None:
        super().__init__(gamma, nystrom=True)  # always in second-order form
        self.order = 2

    @property
    def Abar(self) -> np.ndarray:
        """The stage matrix as printed, in the place of A A."""
        g, s, (b1, b2, _) = self.gamma, self.sigma, self.b
        return np.array([[g**2, 0.0, 0.0], [s, g**2, 0.0], [b1 * g**2, b2 * g**2, g**2]])

    def characteristic(self, x: float, xi: float) -> None:
        """None: the R(z) of (4.14) belongs to A A."""
        return None
