"""Profiles of x as data: they can be compared, printed and sent to another process."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.validation import InputError, number, sequence


@dataclass(frozen=True)
class PolynomialProfile:
    """p(x) = sum_k coefficients[k] x^k, the constant first; what a case file gives as a list.

    Coefficients given as texts, Fractions or Decimals keep their exact values for multiprecision.
    Raises InputError for what is no number, and for none at all.
    """

    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        given = sequence("coefficients", self.coefficients, "be numbers, the constant first", "for example (0, 0, 1)")
        values = tuple(number("coefficients", c, exact=True) for c in given)
        if not values:
            rule = "hold one number at least, the constant"
            raise InputError("coefficients", self.coefficients, rule, "for example (0, 0, 1)")
        object.__setattr__(self, "coefficients", values)

    def __call__(self, x: ArrayLike) -> Array:
        """c_0 + c_1 x + c_2 x^2 + ... at every x."""
        return np.polynomial.polynomial.polyval(np.asarray(x, float), np.array(self.coefficients, float))
