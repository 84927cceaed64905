"""SUNDIALS' variable-order multistep solvers CVODE and IDA (for implicit systems), by the libraries in scikit-sundae.

scikit-sundae takes Python functions only, and three quarters of a solve are spent in them. Its extension modules are
linked to the libraries, so their functions are found through them; with the equations of
``right_hand_side_kernels`` as C functions no Python runs inside a step. ``available`` is False where the installed
wheel does not offer this: then ``cvode`` and ``ida`` go through scikit-sundae, with the same numbers, and so do
functions of time that Python has to call.

SUNDIALS hands over its vectors and matrices as structures. Of a serial vector and of a dense or banded matrix the first
member is the address of a content, in which the numbers' address stands at ``VECTOR``, ``DENSE`` or ``BAND``, verified
once against the library's own functions. The user data is the address of six numbers, see ``USER``.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import lru_cache
from importlib import import_module
from io import StringIO
from typing import IO, Any, NamedTuple, cast

import numpy as np
from numba import types

from ...basics.arrays import Array, IntArray
from ...basics.compiled import called_from_c, compiled
from ...model.right_hand_side import RightHandSide
from ...model.right_hand_side_kernels import event_functions, floats, integers, jacobian, residual, right_hand_side
from ...model.state_space import descriptor
from ...trajectory.trajectory import Reference, SolverFailure
from ..registry import KEEP, RESTART, Request
from .adaptive import Solver, reference_from
from .restarts import Outcome, Phase, Root, refuse_endless

WARNINGS = "SUNLOGGER_WARNING_FILENAME"
MESSAGE = re.compile(r"\n\[\w+, Error: -?\d+\] .*\n", re.DOTALL)  # as scikit-sundae prints one
MAX_STEPS = 10_000_000  # to one output; SUNDIALS' default of 500 ends most contact runs


def solve(request: Request) -> Reference:
    """Return the solution by CVODE or IDA, according to the name of the method.

    CVODE has BDF orders 1-5 or Adams-Moulton orders 1-12, Newton's method with the analytic Jacobian, banded if the
    system's is. Adams restarts at every event, because a method of high order gains by a smooth right-hand side. BDF
    steps through, and error control finds the kink: BDF has order 5 at most and needs many steps to raise its order
    again. Undamped, these systems lie on the imaginary axis, where BDF of order 3 and above is unstable and Adams needs
    a fifth of the work.

    IDA has BDF orders 1-5 on the residual of M q'' + C q' + K q = f, the mass matrix not inverted.

        F(t, y, y') = E y' - g(t, y),  y = (q_1, q_1', ..., q_n, q_n')

    with the analytic iteration matrix c_j E - dg/dy, banded where M, C and K are. It steps through the events.
    """
    import_module("sksundae.cvode")  # a missing library is named before anything is computed
    method, ida, adams = request.method, request.method == "ida", request.method == "cvode-adams"
    mass, right = descriptor(request.system) if ida else (None, None)

    def solver(rhs: RightHandSide, rtol: float, atol: Array) -> Solver:
        if rhs.in_python or not available():
            start = called_from_python(ida, adams, rhs, rtol, atol)
        else:
            start = CompiledSolver("IDA" if ida else "CVode", rhs, rtol, atol, adams).init_step
        return lambda phase: advance(method, start(phase), phase)

    return reference_from(request, solver, RESTART if adams else KEEP, mass, right)


def called_from_python(ida: bool, adams: bool, rhs: RightHandSide, rtol: float, atol: Array) -> Callable[[Phase], Any]:
    """Function that starts a solver of scikit-sundae at the beginning of a phase."""
    from sksundae.cvode import CVODE
    from sksundae.ida import IDA

    def right(t: float, z: Array, rate: Array) -> None:
        rhs(t, z, rate)

    def slopes(t: float, z: Array, rate: Array, J: Array) -> None:
        J[:] = rhs.jacobian(t, z)

    def defect(t: float, z: Array, rate: Array, res: Array) -> None:
        rhs.residual(t, z, rate, res)

    def iteration_matrix(t: float, z: Array, rate: Array, res: Array, cj: float, J: Array) -> None:
        J[:] = rhs.jacobian(t, z, cj, -1.0)

    def start(phase: Phase) -> Any:
        def roots(t: float, z: Array, out: Array) -> None:
            phase.watch(t, z, out)

        def roots_with_rate(t: float, z: Array, rate: Array, out: Array) -> None:
            phase.watch(t, z, out)

        if ida:
            options = phase_options(rhs, phase, roots_with_rate)
            solver: Any = IDA(defect, rtol=rtol, atol=atol, jacfn=iteration_matrix, **options)
            begun = phase.start, phase.z, rhs.rate(phase.start, phase.z)
        else:
            options = phase_options(rhs, phase, roots) | {"method": "Adams" if adams else "BDF"}
            solver = CVODE(right, rtol=rtol, atol=atol, jacfn=slopes, **options)
            begun = phase.start, phase.z
        return _Quiet(solver, *begun)

    return start


class _Quiet:
    """A solver of scikit-sundae, started at a time and state, that prints no messages of SUNDIALS: its statuses have
    them. What functions of the user print passes.

    Warnings go to the log that the environment names at the start, errors through Python's ``print``.
    """

    def __init__(self, solver: Any, *begun: Any) -> None:
        self.solver, chosen = solver, WARNINGS in os.environ  # a user may have named a log
        if not chosen:
            os.environ[WARNINGS] = os.devnull
        try:
            solver.init_step(*begun)
        finally:
            if not chosen:
                del os.environ[WARNINGS]

    def step(self, target: float, tstop: float) -> Any:
        """Integrate to ``target``, not beyond ``tstop``, or to an event."""
        with redirect_stdout(cast(IO[str], _Output(sys.stdout or StringIO()))):
            return self.solver.step(target, tstop=tstop)


class _Output:
    """A stream without SUNDIALS' messages, each of which is followed by a line break."""

    def __init__(self, stream: IO[str]) -> None:
        self.stream, self.left_out = stream, False

    def write(self, text: str) -> int:
        """Write what is no message."""
        after, self.left_out = self.left_out, MESSAGE.fullmatch(text) is not None
        return len(text) if self.left_out or (after and text == "\n") else self.stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


def phase_options(rhs: RightHandSide, phase: Phase, roots: Callable[..., None]) -> dict[str, Any]:
    """Direct linear solver, banded where that pays, root functions and step bound. Made anew for each phase: events
    accumulate in a solver."""
    options: dict[str, Any] = {"max_num_steps": MAX_STEPS, "linsolver": "dense"}
    if rhs.bandwidths is not None:
        lower, upper = rhs.bandwidths
        options |= {"linsolver": "band", "lband": lower, "uband": upper}
    if np.isfinite(phase.max_step):
        options["max_step"] = phase.max_step
    if phase.watch.count:
        roots.terminal = [True] * phase.watch.size  # type: ignore[attr-defined]
        roots.direction = phase.watch.directions  # type: ignore[attr-defined]
        options |= {"eventsfn": roots, "num_events": phase.watch.size}
    return options


def advance(method: str, solver: Any, phase: Phase) -> Outcome:
    """Step an initialised solver from output to output, until a root ends the phase."""
    states, ended_by = [], []
    t, z, result = phase.start, phase.z, None
    least = 8.0 * np.finfo(float).eps * phase.end  # SUNDIALS refuses a first output closer than that
    # Targets are the outputs, and the end of the phase where it is no output.
    for target in [*phase.times, *([phase.end] if not len(phase.times) or phase.times[-1] < phase.end else [])]:
        if target - phase.start <= least:
            states.append(z)
            t = float(target)
            continue
        while not ended_by:
            # Without the stop time a step could go beyond the smooth interval and interpolate back.
            result = solver.step(float(target), tstop=phase.end)
            if not result.success:
                message, remedy = str(result.message), "loosen rtol and atol or take the exact solution"
                raise SolverFailure(method, float(result.t), message, remedy)
            t, z = float(result.t), np.asarray(result.y)
            refuse_endless(method, t, int(result.nfev))
            if result.status != 2:  # not a root: the output time, or the end
                break
            # Roots: only some end a phase; after the others the solver goes on to the same target.
            flags = np.asarray(result.i_events)[-1]
            roots = [Root(int(k), int(flags[k]), t, z) for k in np.flatnonzero(flags)]
            if phase.watch.ends(roots):
                ended_by = roots
        if ended_by:
            break
        states.append(z)
    counters: dict[str, int] = {}
    if result is not None:
        counters = {"rhs": int(result.nfev), "jacobians": int(result.njev), **getattr(result, "statistics", {})}
    # The end of the phase is an output only if it was asked for.
    return Outcome(
        t if ended_by else phase.end, z, states[: len(phase.times)], ended_by, phase.watch.missed(ended_by), counters
    )


# ---------------------------------------------------------------- the libraries, called with compiled equations

VECTOR, DENSE, BAND = 1, 1, 3  # words of 8 bytes into the content; indices of SUNDIALS have 4 bytes
USER = 6  # words of the user data: block, its length, unknowns, event functions, first, stride (see jacobian)

REAL, ADDRESS, INT = types.float64, types.int64, types.int32


@compiled
def numbers_of(structure: int, word: int, size: int) -> Array:
    """Return the ``size`` numbers of a vector or matrix of SUNDIALS."""
    content = integers(structure, 1)[0]
    return floats(integers(content, word + 1)[word], size)


@compiled
def block_in(user: IntArray) -> IntArray:
    """Return the block of the equations."""
    return integers(user[0], user[1])


@compiled
def fill(t: float, y: int, matrix: int, data: int, cj: float, sign: float) -> None:
    """Write cj E + sign df/dz into a matrix of SUNDIALS."""
    user = integers(data, USER)
    size, first, stride = user[2], user[4], user[5]
    word = DENSE if stride == size else BAND
    J = numbers_of(matrix, word, size * (stride if word == DENSE else stride + 1))
    jacobian(t, numbers_of(y, VECTOR, size), cj, sign, J, first, stride, block_in(user))


@called_from_c(INT(REAL, ADDRESS, ADDRESS, ADDRESS))
def cvode_right_hand_side(t: float, y: int, rate: int, data: int) -> int:
    """CVRhsFn."""
    user = integers(data, USER)
    right_hand_side(t, numbers_of(y, VECTOR, user[2]), numbers_of(rate, VECTOR, user[2]), block_in(user))
    return 0


@called_from_c(INT(REAL, ADDRESS, ADDRESS, ADDRESS))
def cvode_events(t: float, y: int, out: int, data: int) -> int:
    """CVRootFn."""
    user = integers(data, USER)
    event_functions(t, numbers_of(y, VECTOR, user[2]), floats(out, user[3]), block_in(user))
    return 0


@called_from_c(INT(REAL, ADDRESS, ADDRESS, ADDRESS, ADDRESS, ADDRESS, ADDRESS, ADDRESS))
def cvode_jacobian(t: float, y: int, rate: int, matrix: int, data: int, a: int, b: int, c: int) -> int:
    """CVLsJacFn."""
    fill(t, y, matrix, data, 0.0, 1.0)
    return 0


@called_from_c(INT(REAL, ADDRESS, ADDRESS, ADDRESS, ADDRESS))
def ida_residual(t: float, y: int, rate: int, out: int, data: int) -> int:
    """IDAResFn."""
    user = integers(data, USER)
    size = user[2]
    y_, rate_, out_ = numbers_of(y, VECTOR, size), numbers_of(rate, VECTOR, size), numbers_of(out, VECTOR, size)
    residual(t, y_, rate_, out_, block_in(user))
    return 0


@called_from_c(INT(REAL, ADDRESS, ADDRESS, ADDRESS, ADDRESS))
def ida_events(t: float, y: int, rate: int, out: int, data: int) -> int:
    """IDARootFn."""
    user = integers(data, USER)
    event_functions(t, numbers_of(y, VECTOR, user[2]), floats(out, user[3]), block_in(user))
    return 0


@called_from_c(INT(REAL, REAL, ADDRESS, ADDRESS, ADDRESS, ADDRESS, ADDRESS, ADDRESS, ADDRESS, ADDRESS))
def ida_jacobian(
    t: float, cj: float, y: int, rate: int, res: int, matrix: int, data: int, a: int, b: int, c: int
) -> int:
    """IDALsJacFn."""
    fill(t, y, matrix, data, cj, -1.0)
    return 0


TESTED = (7,)  # major versions of SUNDIALS whose functions are called as below
ADAMS, BDF, NORMAL = 1, 2, 1
ROOT_RETURN, TOO_MUCH_WORK = 2, -1
STEPS_A_CALL = 20_000  # after which Python may look for an interrupt
STATISTICS = {
    "steps": "GetNumSteps",
    "error_test_failures": "GetNumErrTestFails",
    "convergence_failures": "GetNumNonlinSolvConvFails",
}
POINTER, INTEGER, LONG, DOUBLE = ctypes.c_void_p, ctypes.c_int, ctypes.c_long, ctypes.c_double


class _Library:
    """The functions of one extension module of scikit-sundae and of the libraries that it is linked to."""

    def __init__(self, module: Any) -> None:
        self._library = ctypes.CDLL(module.__file__)
        self.messages: dict[int, str] = getattr(module, "CVMESSAGES", None) or module.IDAMESSAGES

    def __call__(self, name: str, *arguments: Any, result: Any = INTEGER, fails: bool = True) -> Any:
        """Call a function; raise RuntimeError where its result is an error, unless ``fails`` is False."""
        function = getattr(self._library, name)
        function.restype = result
        value = function(*arguments)
        if fails and ((result is POINTER and not value) or (result is INTEGER and value < 0)):
            raise RuntimeError(f"{name} returned {value}")
        return value


@lru_cache
def _libraries() -> dict[str, _Library] | None:
    """The libraries of CVODE and IDA, None if they are not as expected."""
    try:
        # Any difference means the slower way through scikit-sundae, never an error.
        libraries = {family: _Library(import_module(f"sksundae._cy_{family.lower()}")) for family in ("CVode", "IDA")}
        return libraries if all(_as_expected(library) for library in libraries.values()) else None
    except (ImportError, AttributeError, OSError, RuntimeError):
        return None


def _as_expected(library: _Library) -> bool:
    """Return True where version and memory layout are those that the callbacks read."""
    major, rest = INTEGER(), [INTEGER(), INTEGER()]
    label = ctypes.create_string_buffer(32)
    library("SUNDIALSGetVersionNumber", ctypes.byref(major), *map(ctypes.byref, rest), label, INTEGER(32))
    if major.value not in TESTED:
        return False
    with _Memory(library) as memory:
        vector = memory.vector(np.zeros(4))
        pairs = [(vector, VECTOR, library("N_VGetArrayPointer", vector, result=POINTER))]
        dense = memory.matrix("SUNDenseMatrix", 4, 4)
        pairs.append((dense, DENSE, library("SUNDenseMatrix_Data", dense, result=POINTER)))
        band = memory.matrix("SUNBandMatrix", 4, 1, 1)
        pairs.append((band, BAND, library("SUNBandMatrix_Data", band, result=POINTER)))
        return all(_word(_word(structure.value, 0), word) == data for structure, word, data in pairs)


def _word(address: int | None, k: int) -> int:
    """The k-th 8-byte word at an address."""
    assert address
    return ctypes.c_int64.from_address(address + 8 * k).value


def available() -> bool:
    """Return True where SUNDIALS can be called without Python in its steps."""
    return _libraries() is not None


class _Memory:
    """Objects that SUNDIALS allocates for one solver, freed together."""

    def __init__(self, library: _Library) -> None:
        self.library = library
        self._free: list[Callable[[], Any]] = []
        self.context = POINTER()
        library("SUNContext_Create", INTEGER(0), ctypes.byref(self.context))
        self._free.append(lambda: library("SUNContext_Free", ctypes.byref(self.context)))
        # Failures come back as statuses; the handlers would also write them to the terminal.
        library("SUNContext_ClearErrHandlers", self.context)

    def vector(self, numbers: Array) -> Any:
        """Return a vector whose numbers are those of ``numbers``, which has to outlive it."""
        address = POINTER(numbers.ctypes.data)
        made = POINTER(self.library("N_VMake_Serial", INTEGER(len(numbers)), address, self.context, result=POINTER))
        self._free.append(lambda: self.library("N_VDestroy", made, result=None))
        return made

    def matrix(self, kind: str, *sizes: int) -> Any:
        """Return a matrix of SUNDIALS."""
        made = POINTER(self.library(kind, *map(INTEGER, sizes), self.context, result=POINTER))
        self._free.append(lambda: self.library("SUNMatDestroy", made, result=None))
        return made

    def linear_solver(self, kind: str, vector: Any, matrix: Any) -> Any:
        """Return a direct linear solver."""
        made = POINTER(self.library(kind, vector, matrix, self.context, result=POINTER))
        self._free.append(lambda: self.library("SUNLinSolFree", made))
        return made

    def keep(self, solver: Any, free: str) -> None:
        """Free ``solver`` with the rest."""
        self._free.append(lambda: self.library(free, ctypes.byref(solver), result=None))

    def __enter__(self) -> _Memory:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Free everything, the last first."""
        while self._free:
            self._free.pop()()

    def __del__(self) -> None:
        self.close()


class Step(NamedTuple):
    """End of one call of the solver, in the words of scikit-sundae's result; and STATISTICS, which that leaves out."""

    t: float
    y: Array
    success: bool
    status: int
    message: str
    nfev: int
    njev: int
    i_events: list[IntArray]
    statistics: dict[str, int]


class CompiledSolver:
    """CVODE ("CVode", by BDF or Adams) or IDA ("IDA") with compiled equations; its steps are those of scikit-sundae's.

    One object serves all phases of a solve: ``init_step`` starts it anew.
    """

    def __init__(self, family: str, rhs: RightHandSide, rtol: float, atol: Array, adams: bool = False) -> None:
        libraries = _libraries()
        assert libraries is not None
        self.family, self.rhs, self._call = family, rhs, libraries[family]
        rhs.callbacks = "compiled"
        self._memory = memory = _Memory(self._call)
        size = rhs.size
        # SUNDIALS computes in these NumPy arrays: its vectors only point to them.
        self._y, self._rate, self._atol = np.zeros(size), np.zeros(size), np.array(atol, float)
        self._vectors = [memory.vector(x) for x in ((self._y,) if family == "CVode" else (self._y, self._rate))]
        bands = rhs.bandwidths
        # Storage by columns: entry (i, j) at first + i + j stride, see the kernel jacobian.
        if bands is None:
            first, stride = 0, size
            matrix = memory.matrix("SUNDenseMatrix", size, size)
            linear = memory.linear_solver("SUNLinSol_Dense", self._vectors[0], matrix)
        else:
            lower, upper = bands
            stored = min(size - 1, lower + upper)  # upper bandwidth of the factors
            first, stride = stored, stored + lower
            matrix = memory.matrix("SUNBandMatrix", size, upper, lower)
            linear = memory.linear_solver("SUNLinSol_Band", self._vectors[0], matrix)
        # The callbacks find the equations through these numbers. The count of event functions is set for each phase.
        self._user = np.array([rhs.block.ctypes.data, len(rhs.block), size, 0, first, stride], np.int64)
        assert len(self._user) == USER
        self._linear, self._matrix, self._adams = linear, matrix, adams
        # The solver is created at the first phase.
        self._solver = POINTER()
        self._tolerances = (DOUBLE(rtol), memory.vector(self._atol))
        self._flags = np.zeros(max(1, rhs.roots), np.int32)

    def init_step(self, phase: Phase) -> CompiledSolver:
        """The solver itself, started at the beginning of ``phase`` with its event functions and step bound."""
        call, family, start = self._call, self.family, DOUBLE(phase.start)
        # Start values; IDA also needs rates that satisfy the equations.
        self._y[:] = phase.z
        if family == "IDA":
            self._rate[:] = self.rhs.rate(phase.start, phase.z)
        self._watched = phase.watch.size if phase.watch.count else 0
        self._user[3] = self._watched
        # Later phases start the same solver anew and keep its memory and settings.
        if self._solver:
            call(f"{family}ReInit", self._solver, start, *self._vectors)
        else:
            arguments = (INTEGER(ADAMS if self._adams else BDF),) if family == "CVode" else ()
            self._solver = POINTER(call(f"{family}Create", *arguments, self._memory.context, result=POINTER))
            self._memory.keep(self._solver, f"{family}Free")
            first = cvode_right_hand_side if family == "CVode" else ida_residual
            jacobian = cvode_jacobian if family == "CVode" else ida_jacobian
            call(f"{family}Init", self._solver, POINTER(first.address), start, *self._vectors)
            call(f"{family}SetUserData", self._solver, POINTER(self._user.ctypes.data))
            call(f"{family}SVtolerances", self._solver, *self._tolerances)
            call(f"{family}SetLinearSolver", self._solver, self._linear, self._matrix)
            call(f"{family}SetJacFn", self._solver, POINTER(jacobian.address))
            call(f"{family}SetMaxNumSteps", self._solver, LONG(min(STEPS_A_CALL, MAX_STEPS)))
        # Settings that differ from phase to phase.
        longest = phase.max_step if np.isfinite(phase.max_step) else 0.0  # 0 for no bound
        call(f"{family}SetMaxStep", self._solver, DOUBLE(longest))
        events = cvode_events if family == "CVode" else ida_events
        call(f"{family}RootInit", self._solver, INTEGER(self._watched), POINTER(events.address))
        call(f"{family}SetNoInactiveRootWarn", self._solver)  # a start on a stop has such a root
        if self._watched:
            directions = np.array(phase.watch.directions, np.int32)
            call(f"{family}SetRootDirection", self._solver, POINTER(directions.ctypes.data))
        return self

    def step(self, target: float, tstop: float) -> Step:
        """Integrate to ``target``, not beyond ``tstop``, or to an event."""
        call, family = self._call, self.family
        call(f"{family}SetStopTime", self._solver, DOUBLE(tstop))
        reached, status = DOUBLE(), TOO_MUCH_WORK
        # Integrate, in calls of limited work.
        name, at = ("CVode", 1) if family == "CVode" else ("IDASolve", 0)  # where they return the time
        arguments = [self._solver, DOUBLE(target), *self._vectors, INTEGER(NORMAL)]
        arguments.insert(2 + at, ctypes.byref(reached))
        for _ in range(-(-MAX_STEPS // STEPS_A_CALL)):  # an interrupt is raised here, between two calls
            status = call(name, *arguments, fails=False)
            if status != TOO_MUCH_WORK:
                break
        # Roots and counts of the call.
        events: list[IntArray] = []
        if status == ROOT_RETURN:
            call(f"{family}GetRootInfo", self._solver, POINTER(self._flags.ctypes.data))
            events.append(self._flags[: self._watched].astype(np.int64))
        counted = "GetNumRhsEvals" if family == "CVode" else "GetNumResEvals"
        evaluations, jacobians = self._count(counted), self._count("GetNumJacEvals")
        statistics = {word: self._count(name) for word, name in STATISTICS.items()}
        call(f"{family}ClearStopTime", self._solver)
        message = call.messages.get(status, f"SUNDIALS returned {status}")
        y = self._y.copy()
        return Step(reached.value, y, status >= 0, status, message, evaluations, jacobians, events, statistics)

    def _count(self, name: str) -> int:
        """Return one of the counts that the solver keeps since its start."""
        number = LONG()
        self._call(f"{self.family}{name}", self._solver, ctypes.byref(number))
        return number.value
