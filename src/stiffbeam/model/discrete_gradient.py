"""Mean forces of a stop, from its energies at two positions: over a step, and around a node.

Over a step the mean force neither gains nor loses energy:

    F = -(U(u+) - U(u0))/(u+ - u0),   u+ = r + s F

u0 at the start of the step, r where it would end without the force. F does the work F (u+ - u0) = U(u0) - U(u+)
whatever the step is, so that a scheme which conserves the energy of the linear system under a force that is
constant over the step conserves the sum of both. U is convex, so its secant slope grows with u+ and there is
one F. Source: Gonzalez, J. Nonlinear Sci. 6 (1996) 449-467; Simo and Tarnow, ZAMP 43 (1992) 757-792.

Around a node it is the force averaged over one step, half of it before the node and half after, at the node's velocity:

    F = -(U(u + h) - U(u - h))/(2 h),   u = r + s F,   h = w + s' F

h is what the node covers in half a step. The windows of consecutive steps join, so that a contact acts for as long as
it lasts, where F(u) acts for a whole number of steps. Both have order 2, but only the slope of the average has: it is
the share of the window in contact. F is unique if s >= s', because U'' enters with weights s + s' and s - s' at the two
ends. The averaged contact conserves no energy.
"""

from __future__ import annotations

import math

from ..basics.compiled import compiled
from .contact_law import NEWTON, Law, depth, elastic, elastic_slope, is_spring, mean_elastic, stored


@compiled
def secant(u: float, u0: float, law: Law) -> float:
    """(U(u) - U(u0))/(u - u0), U'(u0) where they are equal."""
    a, b = depth(u0, law.g1, law.g2), depth(u, law.g1, law.g2)
    if a > 0.0 and b > 0.0:
        return mean_elastic(a, b, law)
    if a < 0.0 and b < 0.0:
        return -mean_elastic(-a, -b, law)
    if u == u0:
        return elastic(a, law)
    return (stored(b, law) - stored(a, law)) / (u - u0)


@compiled
def _linear(rho: float, d0: float, s: float, kappa: float) -> float:
    """P = -F on one stop that is a spring, from the depths rho = r - g2 and d0 = u0 - g2 < 0 outside; P >= 0."""
    if d0 > 0.0:
        P = kappa * (rho + d0) / (2.0 + kappa * s)  # inside at both ends
        if rho - s * P >= 0.0:
            return P
        out, held = d0 - rho, 0.5 * kappa * d0 * d0  # s P^2 + (d0 - rho) P = U(u0)
        root = math.sqrt(out * out + 4.0 * s * held)
        return 2.0 * held / (out + root) if out > 0.0 else (root - out) / (2.0 * s)
    if rho <= 0.0:
        return 0.0
    # (kappa s^2/2 + s) P^2 - (kappa s rho + rho - d0) P + kappa rho^2/2 = 0, the smaller root
    way = rho - d0
    return kappa * rho * rho / (kappa * s * rho + way + math.sqrt(way * way - 2.0 * kappa * s * rho * d0))


@compiled
def mean_force(r: float, u0: float, s: float, law: Law) -> tuple[float, float]:
    """(F, dF/dr): in closed form on one stop that is a spring, else by Newton's method inside its bracket."""
    slope = secant(r, u0, law)
    if slope == 0.0:
        return 0.0, 0.0
    F, in_range = 0.0, False
    if is_spring(law):
        if slope > 0.0 and u0 >= law.g1:
            F = -_linear(r - law.g2, u0 - law.g2, s, law.kappa)
            in_range = r + s * F >= law.g1
        elif slope < 0.0 and u0 <= law.g2:
            F = _linear(law.g1 - r, law.g1 - u0, s, law.kappa)
            in_range = r + s * F <= law.g2
    if not in_range:
        # P = |F| in [0, |slope|]; the node moves back by s P.
        sign = math.copysign(1.0, slope)
        left, right, P = 0.0, abs(slope), 0.0
        for _ in range(NEWTON):
            u = r - sign * s * P
            value = sign * secant(u, u0, law)
            if value > P:
                left = P
            else:
                right = P
            new = P + (value - P) / (1.0 + s * _secant_slope(u, u0, sign * value, law))
            if not left <= new <= right:
                new = 0.5 * (left + right)
            change, P = abs(new - P), new
            if change <= 2e-16 * P or left >= right:
                break
        F = -sign * P
    stiff = _secant_slope(r + s * F, u0, -F, law)
    return F, -stiff / (1.0 + s * stiff)


@compiled
def _secant_slope(u: float, u0: float, slope: float, law: Law) -> float:
    """d secant/du, to what Newton's method needs."""
    if abs(u - u0) <= 1e-7 * (abs(u) + abs(u0)):
        d = abs(depth(0.5 * (u + u0), law.g1, law.g2))
        return 0.5 * elastic_slope(d, law) if d > 0.0 else 0.0
    return max(0.0, (elastic(depth(u, law.g1, law.g2), law) - slope) / (u - u0))


@compiled
def averaged_force(r: float, w: float, s: float, s_rate: float, law: Law) -> tuple[float, float, float]:
    """(F, dF/dr, dF/dw) of the force averaged around a node, by Newton's method inside its bracket."""
    mean = secant(r + w, r - w, law)
    if mean == 0.0:
        return 0.0, 0.0, 0.0
    sign = math.copysign(1.0, mean)
    left, right, P = 0.0, abs(mean), 0.0
    to_depth = to_way = 0.0
    for _ in range(NEWTON):
        u, h = r - sign * s * P, w - sign * s_rate * P
        value = sign * secant(u + h, u - h, law)
        to_depth, to_way = _averaged_slopes(u, h, sign * value, law)
        if value > P:
            left = P
        else:
            right = P
        new = P + (value - P) / (1.0 + s * to_depth + s_rate * to_way)
        if not left <= new <= right:
            new = 0.5 * (left + right)
        change, P = abs(new - P), new
        if change <= 2e-16 * P or left >= right:
            break
    below = 1.0 + s * to_depth + s_rate * to_way
    return -sign * P, -to_depth / below, -to_way / below


@compiled
def _averaged_slopes(u: float, h: float, mean: float, law: Law) -> tuple[float, float]:
    """Derivatives of (U(u + h) - U(u - h))/(2 h) by u and by h."""
    d = depth(u, law.g1, law.g2)
    if abs(h) <= 1e-7 * abs(d) or h == 0.0:
        return (elastic_slope(abs(d), law) if d != 0.0 else 0.0), 0.0
    ahead, behind = elastic(depth(u + h, law.g1, law.g2), law), elastic(depth(u - h, law.g1, law.g2), law)
    return 0.5 * (ahead - behind) / h, (0.5 * (ahead + behind) - mean) / h
