"""The interface of schemes: a linear step from (state, forces at the nodes) to (new state, states at the nodes).

``check_contract`` tests that a step is linear in state, loads and reactions, causal in the nodes, and a pure function.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import partial
from typing import Any, ClassVar

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError
from ..model.equations import FULLY_IMPLICIT, Equation

Step = tuple[Array, list[Array]]  # z at t_{n+1}, and y at the nodes


class Scheme(ABC):
    """A fixed-step scheme on M q'' + C q' + K q = f.

    ``integrate`` accepts any subclass with ``nodes`` and ``step``. The nodes are the c_i in t_n + c_i dt at which the
    scheme needs the force. ``step`` must be linear in (state, loads, reactions) and give the same result for the same
    input. The state at node i must not depend on a force at a later node; ``integrate`` checks this. The state z has
    shape (components, ..., n) and starts with y = (q, q').

    Examples
    --------
    The backward Euler method:

    >>> import stiffbeam as sb
    >>> class Backward(sb.Scheme):
    ...     order = 1
    ...     def step(self, equation, dt, z, loads, reactions):
    ...         y = z + dt * equation.implicit_rate(dt, z, loads[0] + reactions[0])
    ...         return y, [y]
    >>> run = sb.integrate(sb.paper_case(10).system(), Backward(), dt=1e-4, t_end=0.1)
    >>> run.impacts.count > 0
    True
    """

    look: ClassVar[tuple[int, int, int]]  # colour, dashes and marker of a registered class, see figures/chart.py
    variants: ClassVar[tuple[dict[str, Any], ...]] = ()  # parameters that tests and studies try beside the defaults
    nodes: tuple[float, ...] = (1.0,)
    order: int = 2  # on smooth problems
    history: ClassVar[int] = 1  # number of past y that ``initial`` takes
    arguments: ClassVar[tuple[str, ...]] = ()  # of the class, each kept under its name: they are the ``parameters``

    @property
    def starter(self) -> Scheme | None:
        """The one-step scheme that makes the first ``history - 1`` steps."""
        return None

    def initial(self, equation: Equation, history: list[Array], force: Array) -> Array:
        """The state at t_n from the past y, newest first, and the total force at t_n."""
        return history[0]

    @property
    def conserving(self) -> Scheme | None:
        """The form whose reaction is constant over the step, for schemes that conserve energy under such a force:
        the reaction at its one node is the mean over the step. None for others."""
        return None

    @abstractmethod
    def step(self, equation: Equation, dt: float, z: Array, loads: list[Array], reactions: list[Array]) -> Step:
        """(z at t_{n+1}, y at the nodes) from z at t_n and what acts at the nodes, one (..., n) each:
        the loads, and apart from them the reactions of the contacts."""

    def predict(self, equation: Equation, dt: float, z: Array) -> list[Array]:
        """Positions at the nodes from known values, for the extrapolated contact: q + c_i dt q'.

        The paper gives a formula for BDF2 only. This one reproduces its Tables 10-13; v* = q does not.
        """
        return [z[0] + c * dt * z[1] for c in self.nodes]

    def characteristic(self, x: float, xi: float) -> Array | None:
        """Coefficients, highest first, of the polynomial whose roots amplify q'' + 2 xi w q' + w^2 q = 0, x = w dt.

        In closed form, for theory beside the step itself; None where a scheme states none. A scheme on
        y' = z y gives that of z = ``oscillator(x, xi)``; the conjugate roots belong to it.
        """
        return None

    @property
    def parameters(self) -> dict[str, Any]:
        """The arguments that make this scheme again, for labels and provenance."""
        return {name: getattr(self, name) for name in self.arguments}

    def label(self, digits: int | None = None) -> str:
        """Return the one name of the scheme in tables, pictures, files and JSON, its class with its parameters.

        digits: of the parameters, where space is short; flags that leave the scheme the same are left out then.

        >>> from stiffbeam import BDF2, HHT, SDIRK
        >>> str(HHT(alpha=-0.1)), str(BDF2()), SDIRK(nystrom=True).label(digits=4)
        ('HHT(alpha=-0.1)', 'BDF2', 'SDIRK(gamma=0.4359)')
        """
        inside = ", ".join(
            f"{name}={value:.{digits}g}" if digits and isinstance(value, float) else f"{name}={value!r}"
            for name, value in self.parameters.items()
            if digits is None or not isinstance(value, bool)
        )
        name = type(self).__name__
        return f"{name}({inside})" if inside else name

    def __str__(self) -> str:
        return self.label()

    def __repr__(self) -> str:
        """The constructor call of the scheme."""
        label = self.label()
        return label if label.endswith(")") else f"{label}()"


def require_scheme(scheme: Any) -> Scheme:
    """``scheme`` where it is a Scheme object."""
    if not isinstance(scheme, Scheme):
        remedy = "for example stiffbeam.HHT(alpha=-0.1)"
        if isinstance(scheme, type) and issubclass(scheme, Scheme):
            remedy = f"make an object of the class: {scheme.__name__}()"
        elif callable(scheme):
            remedy = "compare, score and stiffbeam.testing.check_solver take functions"
        raise InputError("scheme", scheme, "be a Scheme object", remedy)
    return scheme


def oscillator(x: float, xi: float) -> complex:
    """z = dt times the eigenvalue of q'' + 2 xi w q' + w^2 q = 0 in the upper half plane, x = w dt."""
    return x * complex(-xi, (1.0 - xi * xi) ** 0.5)


TWO_MODES = Equation(np.ones(2), np.array([0.1, 0.3]), np.array([0.7, 1.9]) ** 2)
TOLERANCE = 1e-10  # of rounding; a broken contract shows at order one


def check_contract(scheme: Scheme) -> None:
    """Raise InputError where ``step`` breaks the contract that both marches rely on.

    Tried on two damped modes with random states, loads and reactions: step(x + 2 y) = step(x) + 2 step(y),
    and so for ``predict``; no state at a node changes with a load or a reaction at a later one; nothing in
    one mode changes with the other; and the same input gives the same bits again. ``integrate`` checks the schemes of
    others, tests those of this package.
    """
    if scheme.starter is not None:
        check_contract(scheme.starter)
    # Random numbers without structure, so that no defect of a step cancels by chance; always the same ones.
    rng, nodes = np.random.default_rng(0), len(scheme.nodes)
    history = [rng.normal(size=(2, 2)) for _ in range(scheme.history)]
    shape = scheme.initial(TWO_MODES, history, rng.normal(size=2)).shape
    step = partial(_tried, scheme, shape)

    def require(holds: bool, got: str, rule: str, remedy: str) -> None:
        if not holds:
            raise InputError(f"{scheme}.step", got, rule, remedy)

    x, y = ((rng.normal(size=shape), rng.normal(size=(2, nodes, 2))) for _ in range(2))
    once = step(*x)
    # Linear: a march solves for the reaction by the response to it alone.
    for whole, a, b in zip(step(x[0] + 2.0 * y[0], x[1] + 2.0 * y[1]), once, step(*y), strict=True):
        linear = bool(np.max(np.abs(whole - a - 2.0 * b)) <= TOLERANCE * np.max(np.abs(whole)))
        remedy = "leave out what is constant, squared or cut off"
        require(linear, "a step that is not", "be linear in (state, loads, reactions)", remedy)
    # Pure: a march computes the response of a step once and uses it in every step.
    same = all(np.array_equal(first, again) for first, again in zip(once, step(*x), strict=True))
    remedy = "keep nothing on self; what a step needs of earlier ones belongs into the state"
    require(same, "a step that remembers", "give the same for the same input", remedy)
    # Mode by mode: what happens to the second mode must not change the first.
    other = step(*(part + np.array([0.0, 1.0]) for part in x))
    for first, changed in zip(once, other, strict=True):
        apart = bool(np.max(np.abs(first - changed)[..., 0]) <= TOLERANCE * np.max(np.abs(first)))
        rule = "be made of the equation's operations, so that modes do not mix"
        remedy = "use equation.mass, stiffness, damping and solve"
        require(apart, "a step that mixes unknowns by itself", rule, remedy)
    # Causal. No tolerance: the earlier nodes repeat the same operations on the same numbers.
    for later in range(1, nodes):
        changed = x[1].copy()
        changed[:, later] += 1.0
        got = f"a state before node {later} that moves with the force there"
        remedy = f"let every node depend on its own and earlier forces only; {FULLY_IMPLICIT}"
        require(not np.any((step(x[0], changed)[1] - once[1])[:later]), got, "be causal", remedy)


def _tried(scheme: Scheme, shape: tuple[int, ...], z: Array, forces: Array) -> tuple[Array, Array, Array]:
    """New state, states at the nodes and predicted positions of a step on TWO_MODES. Raises InputError for others than
    a state of this ``shape``, and y and a position for each node."""
    z_new, stages = scheme.step(TWO_MODES, 0.4, z, list(forces[0]), list(forces[1]))
    nodes = len(scheme.nodes)
    if len(stages) != nodes or any(np.shape(y) != (2, 2) for y in stages) or np.shape(z_new) != shape:
        got = f"{len(stages)} states at nodes, of shapes {[np.shape(y) for y in stages]}, and {np.shape(z_new)}"
        rule = f"return a state of shape {shape} and {nodes} y = (q, q') of shape (2, 2), one per node"
        raise InputError(f"{scheme}.step", got, rule, "the class stiffbeam.Trapezoidal shows how")
    predicted = scheme.predict(TWO_MODES, 0.4, z)
    if len(predicted) != nodes:
        remedy = "return one for each of the scheme's nodes"
        raise InputError(f"{scheme}.predict", len(predicted), f"return {nodes} positions, one per node", remedy)
    return np.asarray(z_new), np.array(stages), np.array(predicted)


def is_known(scheme: Scheme) -> bool:
    """Return True if the scheme is of this package. Type and label then define it."""
    return type(scheme).__module__.rpartition(".")[0] == __package__
