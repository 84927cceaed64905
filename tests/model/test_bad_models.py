"""What a beam, a system, a function of time or a member may not be: one sentence with rule, value and remedy."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse
from systems import one_mass

import stiffbeam as sb
from stiffbeam.model.members import EnsembleMembers

TIP, DAMPED = sb.Stops(-0.1, 0.1, stiffness=2e5), sb.Stops(upper=0.0, stiffness=1.0, damping=0.1)
ONE, EYE, T = [[1.0]], np.eye(2), [0.0, 1.0, 2.0]
STRIP = {"length": 2.0, "stiffness": 3.0, "mass_per_length": 0.7}


def beam(supports="clamped-free", **fields):
    return sb.BeamProblem(stiffness=3.0, length=2.0, mass_per_length=0.7, supports=supports, **fields)


def grid(cells=8, form="displacement", **fields):
    return sb.semidiscretise(beam(**fields), cells, form)


def system(**fields):
    """Two unknowns, some of whose fields are wrong; whichever way they are given."""
    good = {"mass": EYE, "damping": np.zeros((2, 2)), "stiffness": EYE, "observe": np.ones(2), "q0": np.zeros(2),
            "v0": np.zeros(2)}  # fmt: skip
    with pytest.raises(sb.InputError) as caught:
        replace(sb.System(**good), **fields)
    with pytest.raises(sb.InputError, match=re.escape(str(caught.value))):
        sb.System(**(good | fields))
    raise caught.value


def member(path, **start):
    return sb.varied_members(one_mass(0.0, TIP, load=sb.Constant(-1.0), **start), {path: [1.0]})


def reduced(M, K, C=None, row=(1.0, 0.0, 0.0, 0.0), **options):
    return sb.reduce_model(M, K, C, observe=np.array(row), **({"modes": 1} | options))


def start(profile):
    return lambda: sb.BeamProblem(stiffness=1.0, base=sb.Constant(0.1), initial_displacement=profile)


def lists(n, shift):
    """A banded and a full matrix whose least eigenvalue is below zero by little."""
    bands = np.diag(np.full(n, 2.0)) - np.eye(n, k=1) - np.eye(n, k=-1)
    full = bands + 1e-3 * np.ones((n, n)) / n
    return [m - (float(np.linalg.eigvalsh(m)[0]) + shift) * np.eye(n) for m in (bands, full)]


HALF = scipy.sparse.triu(scipy.sparse.coo_array([[2.0, -1.0], [-1.0, 2.0]]))
NO_BEAM = [
    (lambda: beam("clamped-hinged"), "supports must be known"),
    (lambda: beam("free-free", base=sb.Constant(0.1)), "base must be None for a free-free beam"),
    (lambda: beam("clamped-pinned", tip_mass=0.1), "tip_mass must be 0 for a clamped-pinned beam"),
    (lambda: beam(tip_mass=-0.1), "tip_mass must be >= 0"), (lambda: beam(modal_damping=-0.1), "modal_damping"),
    (lambda: beam("pinned-pinned", stops=sb.Stops(upper=1, stiffness=1)), "must lie inside a pinned-pinned beam"),
    (lambda: beam("clamped-clamped", initial_displacement=lambda x: x**2), "initial_displacement must equal"),
    (lambda: beam("clamped-clamped", initial_displacement=lambda x: x**2 * (x - 2.0)), "zero slope at the clamp x"),
    *((lambda x=x: sb.BeamProblem(stiffness=x), f"^stiffness must {rule}, got {re.escape(repr(x))}")
      for x, rule in ((0, "be > 0"), (math.nan, "be finite"), (True, "be a number"))),
    (lambda: beam(viscosity=-1e-9), "^viscosity must be >= 0"),
    (lambda: beam(stops=(-0.1, 0.1)), "^stops must be a Stops or a list of them"),
    (lambda: beam(base=np.sin), r"^base must have value\(t\), rate\(t\)"),
    (lambda: beam(loads=(sb.Constant(1.0),)), "^loads must hold PointLoad and DistributedLoad only"),
    (start(lambda x: 0.2 + 0.0 * x), r"equal the base motion phi\(0\) = 0.1 at x = 0"),
    (start(lambda x: 0.1 + 0.5 * x), "have zero slope at the clamp x = 0"),
    *((start(f), "return one finite value per x")
      for f in (lambda x: np.where(x > 0.6, np.nan, 0.1), lambda x: 0.1, lambda x: np.zeros((len(x), 2)))),
    (lambda: sb.PointLoad(0.0, sb.Constant(1.0)), r"^load\.position must be"),
    (lambda: beam(loads=(sb.PointLoad(2.25, sb.Constant(1.0)),)), r"lie on the beam, 0 < position <= 2, got 2\.25"),
    (lambda: sb.PointLoad(0.5, 3.0), r"^load\.time must be a Harmonic, a Constant or a function of time, got 3"),
    (lambda: beam(loads=sb.DistributedLoad(1.0, sb.Constant(1.0))),
     r"^load\.shape must be a function of x and .* got 1\.0"),
    (lambda: grid(supports="pinned-pinned"), "supports must be clamped-free in the displacement form"),
    (lambda: grid(form="velocity-curvature", tip_mass=1.0), "tip_mass must be 0 in the velocity"),
    (lambda: grid(modal_damping=0.1), "form hermite"),
    (lambda: grid(form="displacment"), "did you mean displacement"), (lambda: grid(3), "cells"),
    (lambda: beam(stops=sb.Stops(upper=0.1, stiffness=1.0, position=0.0)), "must lie inside a clamped-free beam"),
    (lambda: sb.Stops(upper=0.1, stiffness=1.0, position=-1.0), "stops.position must be >= 0"),
    (lambda: sb.Stops(upper=0.1, stiffness=1.0, motion=0.1), "stops.motion must be"),
    (lambda: sb.Contact(np.ones(3), replace(TIP, position=0.6)), "contact.stops.position must be None in a contact"),
    *((lambda name=name: sb.BeamProblem(**STRIP | {name: -1.0}), f"^{name} must") for name in STRIP),
    (lambda: sb.modal_damping(EYE, EYE, [0.1] * 3), "at most one"),
]  # fmt: skip
NO_STOPS = [
    *((lambda x=x: sb.Stops(*x[:2], stiffness=x[2]), words) for *x, words in (
        (-0.1, 0.1, 0.0, "^stops.stiffness must lie in"), (-0.1, 0.1, -math.inf, "^stops.stiffness must be finite"),
        (math.nan, 0.1, 1.0, "^stops.lower must be finite"), (-0.1, math.inf, 1.0, "^stops.upper must be finite"),
        (-0.1, "near", 1.0, "^stops.upper must be a number in the range of float64"),
        (None, None, 1.0, "^stops must have a lower or an upper stop"),
        (0.1, -0.1, 1.0, "^stops.upper must be > stops.lower = 0.1"))),
    *((lambda row=row: sb.Contact(row, TIP), r"^contact.row must (be finite numbers|not be all zero)")
      for row in ([1.0, math.nan], [0.0, 0.0])),
    *((lambda x=x: sb.Stops(upper=0.0, stiffness=1.0, **x), "stops")
      for x in ({"exponent": 0.5}, {"damping": -1.0}, {"dissipation": math.nan}, {"exponent": math.inf})),
    (lambda: DAMPED.force(0.1), "velocity"), (lambda: sb.Contact([1.0], DAMPED, offset=np.sin), "rate"),
]  # fmt: skip
NO_SYSTEM = [
    (lambda: system(mass=np.diag([1.0, 0.0])), "positive definite"), (lambda: system(mass=-EYE), "positive definite"),
    (lambda: system(stiffness=np.diag([1.0, -1.0])), "positive semidefinite"),
    (lambda: system(stiffness=np.array([[1.0, 1.0], [0.0, 1.0]])), "symmetric"),
    *((lambda x=x: system(damping=np.array(x)), "damping must") for x in ([[1.0, 0.0]], np.nan * EYE)),
    (lambda: system(stiffness=np.eye(3)), "shape"), (lambda: system(q0=np.zeros(3)), "2 finite"),
    (lambda: system(v0=np.array([np.nan, 0.0])), "be finite"), (lambda: system(observe=None), "name the row"),
    (lambda: system(loads=[(np.ones(3), sb.Constant(1.0))]), "2 finite"),
    (lambda: system(loads=[(np.zeros(2), sb.Constant(1.0))]), "loads must not be all zero"),
    (lambda: system(contacts=[sb.Contact(np.ones(3), TIP)]), "hold 2 numbers"),
    (lambda: sb.System.from_matrices(np.diag([1.0, 0.0]), EYE, observe=[1.0, 0.0]),
     "mass must be positive definite.*condense"),
    *((lambda m=m: sb.System.from_matrices(EYE, m, observe=[0.0, 1.0]), "stiffness must be positive semidefinite")
      for m in ([[1e10, 0.0], [0.0, -0.05]], [[1e10, 1.0], [1.0, -0.05]], [[1e10, 1e6], [1e6, 1.0]])),
    (lambda: sb.System.from_matrices(EYE, [[1e12, -0.9], [0.0, 0.9]], observe=[0.0, 1.0]), "must be symmetric"),
    *((lambda m=m: sb.System.from_matrices(np.eye(100), m, observe=np.eye(100)[0]), "positive semidefinite")
      for shift in (1e-9, 1.0) for m in lists(100, shift)),
    *((lambda m=m: sb.System.from_matrices(m, np.eye(100), observe=np.eye(100)[0]), "positive definite")
      for m in lists(100, 1e-9)),
    *((lambda given=given: reduced(*given, row=(1.0, 0.0)),
       rf"{name} must be symmetric to .*give both halves: A \+ A\.T without")
      for name, given in (("mass", (HALF, EYE)), ("stiffness", (EYE, HALF)))),
    (lambda: sb.System.from_matrices(HALF, EYE, observe=[1.0, 0.0]), r"mass must be symmetric to .*give both halves"),
    (lambda: reduced(EYE, [[1.0, 1.0], [0.5, 1.0]], row=(1.0, 0.0)),
     "got 'an unsymmetric matrix': give the symmetric part"),
    (lambda: reduced(np.eye(4), np.eye(4), modes=20), "modes"),
    (lambda: reduced(np.eye(4), np.diag([1.0, 1.0, 1.0, 0.0])), "hold the system"),
    (lambda: reduced(np.eye(4), np.eye(4), row=(1.0, 0.0)), "observe must be 4 finite"),
    (lambda: reduced(np.diag([1.0, 1.0, -1.0, 1.0]), np.eye(4)), "positive semidefinite"),
    (lambda: reduced(np.diag([1.0, 0.0, 0.0, 1.0]), np.eye(4), modes=2), "of a rank above 2, got 'rank 2'"),
]  # fmt: skip
NO_FUNCTION = [
    (lambda: sb.Harmonic(math.nan, 1.0), "^amplitude"), (lambda: sb.Harmonic(1.0, 0.0), "^frequency"),
    (lambda: sb.Harmonic(1.0, 1.0, "zero"), "^phase"), (lambda: sb.Constant(None), "^level"),
    (lambda: sb.Superposition(), "^Superposition"), (lambda: sb.Superposition(np.sin), "^Superposition"),
    *((lambda t=t, x=x: sb.Sampled(t, x), f"^{field}") for t, x, field in (
        ([0.0, 1.0, 1.0], T, "sampled.t"), ([0.0], [0.0], "sampled.t"), ([0.0, 1.0], T, "sampled.values"),
        ([0.0, 1.0], ["a", "b"], "sampled.values"), ([0.0, 1e-320], [0.0, 1.0], "sampled.values"))),
    (lambda: sb.Sampled(T, T, "cubics"), "^kind"), (lambda: sb.Sampled(T, T, derivative=2), "^derivative"),
    *((lambda t=t, x=x: sb.Sampled(t, x, "cubic"), "slopes that overflow") for t, x in (
        ([0.0, 1e-308, 1e300, 1.5e300], [0.0, 0.0, 1.0, 0.0]), ([0.0, 1e-200, 2e-200, 1.0], [0.0, 1e100, 0.0, 1.0]))),
    (lambda: sb.Sampled(T, np.ma.array(T, mask=[False, True, False])), "masked"),
    *((lambda text=text: sb.Constant(text), "be a number")
      for text in ("", "fast", "1/0", "1/pi", "pi*pi", "2**3", "1e999/3", "1 0", "--1", "1e-999/3")),
    # A text as large as no number costs no memory.
    *((lambda text=text: sb.Constant(text), "be finite") for text in ("1e999999999", "inf", "nan")),
    (lambda: sb.BeamProblem(stiffness="1e-999999999"), "be > 0"),
    (lambda: sb.Constant(Fraction(10) ** 400), "range of float64"),
]  # fmt: skip
NO_MEMBER = [
    (lambda: EnsembleMembers(one_mass(1.0, TIP), [], {"mass": [1.0]}), "one value per member"),
    (lambda: EnsembleMembers(one_mass(1.0, TIP), [one_mass(1.0)]), "unknowns and contacts"),
    *((lambda path=path: member(path), "did you mean|known: frequency") for path in (
        "", ".", "stops", "stops.stifness", "stops[2].damping", "q0[3]", "loads[0]", "base.frequency")),
]  # fmt: skip


@pytest.mark.parametrize(("call", "words"), [*NO_BEAM, *NO_STOPS, *NO_SYSTEM, *NO_FUNCTION, *NO_MEMBER])
def test_a_call(call, words):
    with pytest.raises(sb.InputError, match=words):
        call()


def test_what_is_next_to_a_refusal_is_taken():
    assert issubclass(sb.InputError, ValueError)
    for m in (*lists(100, -1e-12), *lists(100, -1e-3)):
        sb.System.from_matrices(np.eye(100), m, observe=np.eye(100)[0])
    assert sb.Sampled(T, np.ma.array(T, mask=False)) == sb.Sampled(T, T)
