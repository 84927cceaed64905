"""Scales of a system's motion: its speed, and the rate at which each mode turns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..basics.arrays import Array
from .contact import Contact, chord, depth_holding, depth_under, stored
from .modes import Modes, undamped_modes
from .system import System
from .time_functions import Constant, Harmonic, LoadFunction, Sampled, evaluate, parts

UNNOTICED = 0.1  # (rate t_end)^2/12 below 1e-3: a force that turns a mode so slowly does not show in the run
SAMPLES = 4001  # of a function in Python, over a run


@dataclass(frozen=True)
class Scales:
    """Speed and turning rates of the motion on [0, t_end], in undamped modal coordinates with unit mass.

    speed: V, the largest modal speed that the start, the loads and moving stops give,

        V = max(max_j hypot(omega_j eta_j, eta_j'), sqrt(2 U), max_j sum_k s_jk, max_c |o_c'|/sqrt(row_c M^-1 row_c)),

    U the energy of the stops at the start, s_jk the speed that load k gives mode j until the mode, its damping, the
    drive, a stop or the end of the run turns it. A function in Python counts by its samples. rates: (n,), speed over
    amplitude of each mode: the largest of

        omega_j                         its stiffness
        f_j/V                           the constant loads f_j, against which it flies with speed V

    A mode that neither turns noticeably within the run drifts. Its rate is then the least of

        2 V/w_j                         the gap w_j between an upper and a lower stop of one contact
        sqrt(kappa row M^-1 row)        a compliant contact
        a                               a drive of angular frequency a

    and 2 pi/t_end where there is none. The motion in a mode is V/rate large, its
    time scale is 2 pi/rate, at most t_end.
    """

    speed: float
    rates: Array

    @property
    def period(self) -> float:
        """The longest time scale, 2 pi over the least rate; inf where nothing turns."""
        least = float(np.min(self.rates))
        return 2.0 * np.pi / least if least > 0.0 else np.inf


@np.errstate(over="ignore", divide="ignore")  # a speed of inf is refused by those who need one
def scales(system: System, t_end: float = np.inf) -> Scales:
    """The scales of a run of ``system`` to t_end, inf where it is not known."""
    basis, drive = undamped_modes(system), system.drive
    largest = _speed(system, basis, t_end)
    # Constant loads in modal coordinates: a mode flies against them with the speed V.
    constant = basis.force(system.load_amplitudes[0])
    # A mode turns by its stiffness, or against the constant loads.
    rates = np.maximum(basis.omega, 0.0 if largest == 0.0 else np.abs(constant) / largest)
    drifts = rates <= UNNOTICED / t_end
    # Modes that neither turns within the run: gaps, contacts and drives do.
    if np.any(drifts):
        others, least = list(drive.frequencies), np.full(len(rates), np.inf)
        for contact in system.contacts:
            stops, law = contact.stops, contact.stops.law
            if not stops.rigid:  # by the spring with the same force where the stop holds the energy V^2/2
                kappa = chord(depth_holding(0.5 * largest**2, law), law)
                others.append(float(np.sqrt(kappa) * _lightness(basis, contact)))
            across = 2.0 * largest * np.abs(basis.force(contact.row)) / (stops.law.g2 - stops.law.g1)
            least = np.where(across > 0.0, np.minimum(least, across), least)
        least = np.minimum(least, min((x for x in others if x > 0.0), default=np.inf))
        rates = np.where(drifts, np.where(np.isfinite(least), least, 0.0), rates)
    return Scales(largest, np.maximum(rates, 2.0 * np.pi / t_end))


def _speed(system: System, basis: Modes, t_end: float) -> float:
    """V of ``Scales``."""
    damping = np.abs(np.sum(basis.shapes * (system.damping @ basis.shapes), axis=0))
    # Speeds of the start.
    speeds = np.hypot(basis.omega * basis.to_modal(system.q0), basis.to_modal(system.v0))
    driven = np.zeros(len(basis.omega))
    for vector, function in system.loads:
        amplitude, frequency, impulse, _ = _sizes(function, t_end)
        if amplitude:
            force = basis.force(vector)
            # The load acts one way until the fastest of these turns the mode, or the run ends.
            fastest = np.maximum(np.maximum(basis.omega, damping), frequency)
            reach = np.minimum(amplitude / fastest, min(impulse, amplitude * t_end))
            gained = np.multiply(np.abs(force), reach, out=np.zeros_like(force), where=force != 0.0)
            if frequency == 0.0:  # a push that lasts, which a stop ends
                levels = [factor * f.level for factor, f in parts(function) if isinstance(f, Constant)]
                signs = [np.sign(sum(levels))] if len(levels) == len(parts(function)) else [1.0, -1.0]
                falls = [_fall(system, basis, force, sign * amplitude) for sign in signs]
                # What lies on a stop is lifted by a load of both signs.
                fall = np.min(falls, axis=0)
                gained = np.minimum(gained, np.where(fall > 0.0, fall, np.max(falls, axis=0)))
            driven += gained
    # Speeds that stops give: by the energy in them at the start, and by their own motion.
    stored = float(system.energies(np.zeros(()), system.q0, system.v0)[2])
    moving = [_sizes(contact.offset, t_end)[3] / _lightness(basis, contact) for contact in system.contacts]
    return float(max(np.max(speeds), np.max(driven), np.sqrt(2.0 * stored), *moving, 0.0))


def _fall(system: System, basis: Modes, force: Array, level: float) -> Array:
    """The speed (n,) at which a constant force drives each mode on the nearest stop before it, and into it:
    sqrt(2 (f (d + depth) - U(depth))), depth that at which the stop holds the force; inf without such a stop."""
    square, f = np.full(len(force), np.inf), level * force
    # The nearest stop ahead of each mode, on either side of a contact.
    for contact, u in zip(system.contacts, system.positions(0.0, system.q0), strict=False):
        along, stops = basis.force(contact.row), contact.stops
        for side, bound in stops.sides.items():
            towards = side * along * f > 0.0
            pressed = np.abs(f[towards] / along[towards])
            depth = depth_under(pressed, stops.law)
            held = np.zeros_like(depth) if stops.rigid else stored(depth, stops.law)
            gap = max(side * (bound - float(u)), 0.0)
            square[towards] = np.minimum(square[towards], 2.0 * (pressed * (gap + depth) - held))
    return np.where(force == 0.0, 0.0, np.sqrt(square))


def _lightness(basis: Modes, contact: Contact) -> float:
    """sqrt(row M^-1 row), above zero although its square may underflow."""
    return max(float(np.linalg.norm(basis.force(contact.row))), 1e-154)


def _sizes(function: LoadFunction | None, t_end: float) -> tuple[float, float, float, float]:
    """Largest value, least angular frequency, the most that the integral can be, and largest rate."""
    terms = [(abs(factor), _sizes_of(f, t_end)) for factor, f in parts(function) if factor]
    amplitude, impulse, rate = (sum(factor * size[i] for factor, size in terms) for i in (0, 2, 3))
    return amplitude, min((size[1] for _, size in terms), default=0.0), impulse, rate


def _sizes_of(f: LoadFunction, t_end: float) -> tuple[float, float, float, float]:
    """``_sizes`` of a term; of a function in Python by its samples, and 0 where t_end is not known."""
    if isinstance(f, Harmonic):
        return abs(f.amplitude), f.frequency, np.inf, abs(f.amplitude) * f.frequency
    if isinstance(f, Constant):
        return abs(f.level), 0.0, np.inf, 0.0
    if not isinstance(f, Sampled):
        if np.isinf(t_end):
            return 0.0, 0.0, 0.0, 0.0
        t = np.linspace(0.0, t_end, SAMPLES)
        f = Sampled(t, evaluate(f, t))
    values = np.abs(f.value(f.t))
    fastest = np.max(np.abs(f.rate(f.t))) if f.degree else 0.0
    return float(np.max(values)), 0.0, float(np.trapezoid(values, f.t)), float(fastest)
