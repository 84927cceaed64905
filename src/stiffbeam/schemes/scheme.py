"""The interface of schemes: a linear step from (state, forces at the nodes) to (new state, states at the nodes)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError, one_of
from ..model.equations import Equation, Modal

Step = tuple[Array, list[Array]]  # z at t_{n+1}, and y at the nodes
FACTS: dict[str, Any] = {"name": "", "paper": "", "look": None, "variants": ()}  # not inherited


class Scheme(ABC):
    """A fixed-step scheme on M q'' + C q' + K q = f, or on y' = A y + f.

    ``integrate`` accepts any subclass with ``nodes`` and ``step``. The nodes are the c_i in t_n + c_i dt at which the
    scheme needs the force. ``step`` must be linear in (state, loads, reactions) and give the same result for the same
    input. The state at node i must not depend on a force at a later node; ``integrate`` checks this. The state z has
    shape (components, ..., n) and starts with y (see ``equations``).

    A subclass inherits none of the FACTS below. By default its name is that of its class in small letters.

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

    name: ClassVar[str] = ""
    paper: ClassVar[str] = ""  # the paper's equation numbers
    look: ClassVar[tuple[int, int, int] | None] = (
        None  # colour, dashes and marker in every picture, see figures/panels.py
    )
    variants: ClassVar[tuple[dict[str, Any], ...]] = ()  # parameters that tests and studies try beside the defaults
    erratum: ClassVar[str] = ""  # the name of the misprint, for a printed form
    at_any_step: ClassVar[bool] = False  # whether that form runs at any step
    nodes: tuple[float, ...] = (1.0,)
    order: int = 2  # on smooth problems
    history: ClassVar[int] = 1  # number of past y that ``initial`` takes
    second_order_only: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "erratum" in cls.__dict__:  # a printed form shares the facts of the scheme that it misprints
            return
        for fact, default in FACTS.items():
            setattr(cls, fact, cls.__dict__.get(fact, default))
        cls.name = cls.name or cls.__name__.lower()

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

    @property
    def averages(self) -> bool:
        """True for schemes that take the averaged contact: one force in a step, which moves a free node at least as
        far as half a step at the velocity it gives, see ``discrete_gradient``."""
        if len(self.nodes) != 1:
            return False
        free, none = Modal(np.zeros(1), np.zeros(1)), np.zeros(1)
        start = self.initial(free, [np.zeros((2, 1))] * self.history, none)
        _, ((moved, speed),) = self.step(free, 1.0, start, [none], [np.ones(1)])
        return bool(moved[0] >= 0.5 * (1.0 - 1e-9) * speed[0])

    @abstractmethod
    def step(self, equation: Equation, dt: float, z: Array, loads: list[Array], reactions: list[Array]) -> Step:
        """(z at t_{n+1}, y at the nodes) from z at t_n and what acts at the nodes, one (..., n) each:
        the loads, and apart from them the reactions of the contacts."""

    def predict(self, equation: Equation, dt: float, z: Array) -> list[Array]:
        """Positions at the nodes from known values, for the extrapolated contact: q + c_i dt q'.

        The paper gives a formula for BDF2 only. This one reproduces its Tables 10-13; v* = q does not.
        """
        y = z[: equation.order]
        velocity = equation.velocity(y)
        return [y[0] + c * dt * velocity for c in self.nodes]

    def characteristic(self, x: float, xi: float) -> Array | None:
        """Coefficients, highest first, of the polynomial whose roots amplify q'' + 2 xi w q' + w^2 q = 0, x = w dt.

        In closed form, for theory beside the step itself; None where a scheme states none. A scheme on
        y' = z y gives that of z = ``oscillator(x, xi)``; the conjugate roots belong to it.
        """
        return None

    def printed(self, *errata: str) -> Scheme:
        """The scheme as the paper prints it: with the named erratum, or with the one that runs at any step."""
        forms = {form.erratum: form for form in self.printed_forms()}
        if not forms:
            remedy = "HHT and SDIRK have one"
            raise InputError("scheme", str(self), "have a printed form that runs and differs", remedy)
        names = list(errata) or [name for name, form in forms.items() if form.at_any_step]
        for name in names:
            one_of("erratum", name, forms, "be one the paper prints for this scheme")
        if len(names) > 1:
            raise InputError("errata", names, "be one at a time", "each is a scheme of its own")
        return forms[names[0]].of(self)

    @classmethod
    def printed_forms(cls) -> list[type[Scheme]]:
        """Subclasses of the scheme that state an ``erratum``; none if the scheme is itself a printed form."""
        return [] if cls.erratum else [form for form in cls.__subclasses__() if form.erratum]

    @classmethod
    def of(cls, scheme: Any) -> Scheme:
        """The printed form of ``scheme``."""
        raise NotImplementedError

    def check(self, omega_max: float, dt: float) -> None:
        """Raise InputError where the scheme cannot be used with this step; omega_max is the top frequency."""
        return

    @property
    def parameters(self) -> dict[str, Any]:
        """The arguments that make this scheme again, for labels and provenance."""
        return {}

    def label(self, digits: int | None = None, kind: str = "") -> str:
        """Return the one name of the scheme in tables, pictures, files and JSON, its class with its parameters.

        digits: of the parameters, where space is short; flags that leave the scheme the same are left out then. kind:
        the name of the class, where another is wanted.

        >>> from stiffbeam import BDF2, HHT, SDIRK
        >>> str(HHT(alpha=-0.1)), str(BDF2()), SDIRK(nystrom=True).label(digits=4)
        ('HHT(alpha=-0.1)', 'BDF2', 'SDIRK(gamma=0.4359)')
        """
        inside = ", ".join(
            f"{name}={value:.{digits}g}" if digits and isinstance(value, float) else f"{name}={value!r}"
            for name, value in self.parameters.items()
            if digits is None or not isinstance(value, bool)
        )
        # A printed form is a subclass of the scheme that it misprints.
        kind = kind or (type(self).__bases__[0] if self.erratum else type(self)).__name__
        label = f"{kind}({inside})" if inside else kind
        return f"{label}.printed({self.erratum})" if self.erratum else label

    def __str__(self) -> str:
        return self.label()

    def __repr__(self) -> str:
        """The constructor call of the scheme."""
        call, printed, erratum = self.label().partition(".printed(")
        call = call if call.endswith(")") else f"{call}()"
        return f"{call}.printed({erratum.removesuffix(')')!r})" if printed else call


def require_scheme(scheme: Any) -> Scheme:
    """``scheme`` where it is a Scheme object."""
    if not isinstance(scheme, Scheme):
        raise InputError("scheme", scheme, "be a Scheme object", "for example stiffbeam.HHT(alpha=-0.1)")
    return scheme


def oscillator(x: float, xi: float) -> complex:
    """z = dt times the eigenvalue of q'' + 2 xi w q' + w^2 q = 0 in the upper half plane, x = w dt."""
    return x * complex(-xi, (1.0 - xi * xi) ** 0.5)


def in_interval(field: str, value: Any, low: float, high: float, remedy: str = "") -> float:
    """``value`` as a float in [low, high]."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.floating)) or not low <= value <= high:
        remedy = remedy or f"for example {0.5 * (low + high):g}"
        raise InputError(field, value, f"lie in [{low:.6g}, {high:.6g}]", remedy)
    return float(value)
