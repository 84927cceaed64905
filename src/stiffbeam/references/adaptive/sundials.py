"""SUNDIALS' variable-order multistep solvers CVODE and IDA (for implicit systems), by the libraries in scikit-sundae.

scikit-sundae takes Python functions only, and three quarters of a solve are spent in them. Its extension modules are
linked to the libraries, so their functions are found through them, and they get the C functions of ``kernels/rhs.c``:
no Python runs inside a step. A function of time that is in Python is called before the C function, at its time.

SUNDIALS hands over its vectors and matrices as structures, whose layout ``kernels/rhs.c`` states. It is verified here
once against the library's own functions.
"""

from __future__ import annotations

import ctypes
from contextlib import ExitStack
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np

from ...basics.arrays import Array
from ...basics.resources import late
from ...basics.validation import InputError
from ...kernels.library import library
from ...model.right_hand_side import RightHandSide
from ...trajectory.trajectory import Reference, SolverFailure
from ..registry import Request
from .adaptive import reference_from
from .restarts import Phase, Solver, refuse_endless

VERSION = 7  # of SUNDIALS, whose functions are called as below
VECTOR, DENSE, BAND = 1, 1, 3  # words of 8 bytes into a content, see rhs.c; indices of SUNDIALS have 4 bytes
ADAMS, BDF, NORMAL = 1, 2, 1
REACHED, ROOT_RETURN, TOO_MUCH_WORK = (0, 1), 2, -1
STEPS_A_CALL = 1000  # after which Python looks at the clock and for an interrupt
POINTER, INTEGER, LONG, DOUBLE = ctypes.c_void_p, ctypes.c_int, ctypes.c_long, ctypes.c_double
# The C functions of each family with their arguments after the first, which is the time.
FUNCTIONS = {
    "CVode": {
        "cvode_right_hand_side": 3 * [POINTER], "cvode_jacobian": 7 * [POINTER], "cvode_events": 3 * [POINTER],
    },
    "IDA": {
        "ida_residual": 4 * [POINTER], "ida_jacobian": [DOUBLE, *8 * [POINTER]], "ida_events": 4 * [POINTER],
    },
}  # fmt: skip


def solve(request: Request) -> Reference:
    """Return the solution by CVODE or IDA, according to the name of the method.

    CVODE has BDF orders 1-5 or Adams-Moulton orders 1-12, Newton's method with the analytic Jacobian, banded if the
    system's is. Undamped, these systems lie on the imaginary axis, where BDF of order 3 and above is unstable and Adams
    needs a fifth of the work.

    IDA has BDF orders 1-5 on the residual of M q'' + C q' + K q = f, the mass matrix not inverted.

        F(t, y, y') = E y' - g(t, y),  y = (q_1, q_1', ..., q_n, q_n')

    with the analytic iteration matrix c_j E - dg/dy, banded where M, C and K are.
    """
    method = request.method

    def solver(rhs: RightHandSide, rtol: float, atol: Array) -> Solver:
        return Sundials(method, rhs, rtol, atol)

    return reference_from(request, solver, descriptor=method == "ida")


class Library:
    """The functions of the extension module of scikit-sundae for CVode or IDA, and of the libraries that it is linked
    to. Raises InputError where it is not as expected."""

    def __init__(self, family: str) -> None:
        major, rest, label = INTEGER(), [INTEGER(), INTEGER()], ctypes.create_string_buffer(32)
        try:
            module = import_module(f"sksundae._cy_{family.lower()}")
            self._library = ctypes.CDLL(module.__file__)
            self.messages: dict[int, str] = getattr(module, "CVMESSAGES", None) or module.IDAMESSAGES
            self("SUNDIALSGetVersionNumber", ctypes.byref(major), *map(ctypes.byref, rest), label, INTEGER(32))
        except (ImportError, AttributeError, OSError, RuntimeError) as error:
            raise another(str(error)) from error
        if major.value != VERSION:
            raise another(f"version {major.value}")

    def __call__(self, name: str, *arguments: Any, result: Any = INTEGER, fails: bool = True) -> Any:
        """Call a function; raise RuntimeError where its result is an error, unless ``fails`` is False."""
        function = getattr(self._library, name)
        function.restype = result
        value = function(*arguments)
        if fails and ((result is POINTER and not value) or (result is INTEGER and value < 0)):
            raise RuntimeError(f"{name} returned {value}")
        return value

    def has(self, structure: Any, word: int, data: str) -> bool:
        """Return True if this word of the content of a vector or matrix is what a function finds there."""
        content = ctypes.cast(structure, ctypes.POINTER(POINTER)).contents
        return (POINTER * (word + 1)).from_address(content.value or 0)[word] == self(data, structure, result=POINTER)


library_of = cache(Library)


def another(value: str) -> InputError:
    """The error of a library that is not as expected."""
    rule = f"be SUNDIALS {VERSION} as the wheels of scikit-sundae for Linux have it"
    return InputError("the library of cvode and ida", value, rule, "use dop853 or radau")


class Sundials:
    """CVODE (by BDF or Adams) or IDA for the equations of a right-hand side, started anew for every phase."""

    def __init__(self, method: str, rhs: RightHandSide, rtol: float, atol: Array) -> None:
        self.method, self.rhs, self.family = method, rhs, "IDA" if method == "ida" else "CVode"
        self._objects, self._context = ExitStack(), POINTER()  # what SUNDIALS allocates is freed together
        self._call = call = library_of(self.family)
        self._error: BaseException | None = None
        call("SUNContext_Create", INTEGER(0), ctypes.byref(self._context))
        self._objects.callback(call, "SUNContext_Free", ctypes.byref(self._context))
        # Failures come back as statuses; the handlers would also write them to the terminal.
        call("SUNContext_ClearErrHandlers", self._context)
        # SUNDIALS computes in these NumPy arrays: its vectors only point to them.
        self._y, self._rate, self._atol = np.zeros(rhs.size), np.zeros(rhs.size), np.array(atol, float)
        y, rate, tolerances = (
            self._made("N_VMake_Serial", INTEGER(rhs.size), POINTER(x.ctypes.data), free="N_VDestroy")
            for x in (self._y, self._rate, self._atol)
        )
        self._vectors = [y] if self.family == "CVode" else [y, rate]
        (kind, word), sizes = ("Dense", DENSE), [rhs.size, rhs.size]
        if rhs.bandwidths is not None:
            lower, upper = rhs.bandwidths
            (kind, word), sizes = ("Band", BAND), [rhs.size, upper, lower]
        matrix = self._made(f"SUN{kind}Matrix", *map(INTEGER, sizes), free="SUNMatDestroy")
        # Where the numbers of vectors and matrices lie, before C reads them.
        if not (call.has(y, VECTOR, "N_VGetArrayPointer") and call.has(matrix, word, f"SUN{kind}Matrix_Data")):
            raise another("another layout of vectors and matrices")
        linear = self._made(f"SUNLinSol_{kind}", y, matrix, free="SUNLinSolFree")
        # Kept, since those in Python live as long as their objects.
        self._functions = [self._function(*named) for named in FUNCTIONS[self.family].items()]
        first, jacobian, self._events = self._functions
        # Settings that all phases share.
        arguments = (INTEGER(ADAMS if method == "cvode-adams" else BDF),) if self.family == "CVode" else ()
        self._solver = self._made(f"{self.family}Create", *arguments, free=f"{self.family}Free")
        self._set("Init", first, DOUBLE(0.0), *self._vectors)
        self._set("SetUserData", ctypes.byref(rhs.c))
        self._set("SVtolerances", DOUBLE(rtol), tolerances)
        self._set("SetLinearSolver", linear, matrix)
        self._set("SetJacFn", jacobian)
        self._set("SetMaxNumSteps", LONG(STEPS_A_CALL))

    def __del__(self) -> None:
        self._objects.close()

    def _made(self, name: str, *arguments: Any, free: str) -> Any:
        """Return what a function of SUNDIALS makes in this context, which ``free`` frees; a solver by its reference."""
        address = POINTER(self._call(name, *arguments, self._context, result=POINTER))
        freed = ctypes.byref(address) if name.endswith("Create") else address
        self._objects.callback(self._call, free, freed, result=None)
        return address

    def _set(self, name: str, *arguments: Any) -> None:
        self._call(f"{self.family}{name}", self._solver, *arguments)

    def _function(self, name: str, arguments: list[Any]) -> Any:
        """A function of rhs.c; where functions of time are in Python, one that calls these first."""
        address = ctypes.cast(getattr(library(), name), POINTER)
        if not self.rhs.in_python:
            return address
        kind = ctypes.CFUNCTYPE(INTEGER, DOUBLE, *arguments)
        function = kind(address.value or 0)

        def asked(t: float, *rest: Any) -> int:
            try:
                self.rhs.ask(t)
            except BaseException as error:  # raised after the call of SUNDIALS, which C cannot pass on
                self._error = error
                return -1
            return function(t, *rest)

        return kind(asked)

    def __call__(self, phase: Phase) -> dict[str, int]:
        """Integrate a phase from output to output, until a root ends it."""
        self._start(phase)
        # SUNDIALS refuses a first output that is too close: there the state is that of the start.
        soon = phase.t + 8.0 * np.finfo(float).eps * phase.end
        for target in np.union1d(phase.times, phase.end).tolist():
            if target <= soon:
                phase.t = target
            # Only some roots end a phase; after the others the solver goes on to the same target.
            while phase.t < target and not phase.ended_by and not late(phase.t):
                phase.ends(*self._step(phase, target))
                refuse_endless(self.method, phase.t, self._evaluations)
            if phase.t < target or phase.ended_by:
                break
            phase.states.append(phase.z)
        # The end of the phase is an output only if it was asked for.
        del phase.states[len(phase.times) :]
        return {
            "rhs": self._evaluations, "jacobians": self._count("GetNumJacEvals"), "steps": self._count("GetNumSteps"),
            "error_test_failures": self._count("GetNumErrTestFails"),
            "convergence_failures": self._count("GetNumNonlinSolvConvFails"),
        }  # fmt: skip

    def _start(self, phase: Phase) -> None:
        """Start the solver at the beginning of a phase with its event functions and step bound."""
        self._y[:] = phase.z
        if self.family == "IDA":  # it also needs rates that satisfy the equations
            self._rate[:] = self.rhs.rate(phase.t, phase.z)
        self._set("ReInit", DOUBLE(phase.t), *self._vectors)
        longest = phase.max_step if np.isfinite(phase.max_step) else 0.0  # 0 for no bound
        self._set("SetMaxStep", DOUBLE(longest))
        # Without the stop time a step could go beyond the smooth interval and interpolate back.
        self._set("SetStopTime", DOUBLE(phase.end))
        watched = phase.size if phase.count else 0
        self._set("RootInit", INTEGER(watched), self._events)
        self._set("SetNoInactiveRootWarn")  # a start on a stop has such a root
        if watched:
            directions = np.array(phase.directions, np.int32)
            self._set("SetRootDirection", POINTER(directions.ctypes.data))

    def _step(self, phase: Phase, target: float) -> tuple[float, Array, dict[int, int]]:
        """Move a phase on to ``target``, to roots, or by STEPS_A_CALL; time, state, and roots with their signs."""
        reached = DOUBLE()
        time, vectors, name = ctypes.byref(reached), self._vectors, "CVode"
        arguments = [DOUBLE(target), *vectors, time]
        if self.family == "IDA":
            name, arguments = "IDASolve", [DOUBLE(target), time, *vectors]
        status = self._call(name, self._solver, *arguments, INTEGER(NORMAL), fails=False)
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        if status < 0 and status != TOO_MUCH_WORK:
            message = self._call.messages.get(status, f"SUNDIALS returned {status}")
            raise SolverFailure(self.method, reached.value, message, "loosen rtol and atol or take the exact solution")
        phase.t, phase.z = target if status in REACHED else reached.value, self._y.copy()
        flags = np.zeros(phase.size, np.int32)
        if status == ROOT_RETURN:
            self._set("GetRootInfo", POINTER(flags.ctypes.data))
        return phase.t, phase.z, {k: int(flags[k]) for k in np.flatnonzero(flags).tolist()}

    @property
    def _evaluations(self) -> int:
        return self._count("GetNumRhsEvals" if self.family == "CVode" else "GetNumResEvals")

    def _count(self, name: str) -> int:
        """Return one of the counts that the solver keeps since its start."""
        number = LONG()
        self._set(name, ctypes.byref(number))
        return number.value
