"""The ``stiffbeam`` command: modules of commands, which add themselves to the application."""

from __future__ import annotations

import atexit
import gc
import io
import os
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from ..basics.resources import TALK
from . import compare, reference, tools
from .application import app

COMMANDS = (compare, reference, tools)  # each adds its commands to the application
INTERRUPTED = 130  # the exit status of a program that Ctrl-C has stopped
AGAIN = 0.2  # s, until it is looked whether an interruption was heard


class _Output(io.FileIO):
    """Standard output. Once its reader has gone, as behind ``| head``, or its disk is full, the rest goes nowhere."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data) or 0
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())
            if not isinstance(error, BrokenPipeError):
                raise
            return len(data)  # the work goes on, and writes its files


def main() -> None:
    """Entry point: InputError exits with 2, a failure with 1, SIGINT with 130, SIGTERM with 143, each with one line."""
    out = sys.stdout
    if out is sys.__stdout__ and isinstance(out, io.TextIOWrapper) and not out.isatty():
        writer = io.BufferedWriter(_Output(out.fileno(), "w", closefd=False))
        sys.stdout = io.TextIOWrapper(writer, out.encoding, out.errors, None, out.line_buffering, out.write_through)
    if "OMP_NUM_THREADS" not in os.environ:  # before NumPy is there: on small matrices BLAS threads only wait
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("PJRT_NPROC", "1")  # threads of JAX, which on small systems do nothing but seek work
    from ..basics.validation import InputError

    stopped: list[int] = []

    def end(number: int, frame: FrameType | None) -> None:
        stopped.append(number)
        sys.unraisablehook = lambda _: None  # of an object that the compiler had half made
        for name in (signal.SIGINT, signal.SIGTERM):  # a second one does not wait
            signal.signal(name, signal.SIG_DFL)
        if hasattr(signal, "setitimer"):
            signal.signal(signal.SIGALRM, again)
            signal.setitimer(signal.ITIMER_REAL, AGAIN, AGAIN)
            if _in_compiler(frame):
                return  # ``again`` raises it
        raise KeyboardInterrupt

    def again(_: int, frame: FrameType | None) -> None:
        """Python drops an exception that comes within a callback of its garbage collection: then it comes again."""
        if _in_compiler(frame):
            return
        here = sys.exception()
        while here is not None and not isinstance(here, KeyboardInterrupt):
            here = here.__context__
        if here is None:
            raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, end)  # as Ctrl-C: what is finished is kept
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not where a shell has it ignored
        signal.signal(signal.SIGINT, end)
    atexit.register(gc.freeze)  # at the end a search through all modules for garbage would only take time
    try:
        app()
    except InputError as error:
        _fail(error, 2)
    except OSError as error:
        _fail(error, 1)
    except RuntimeError as error:
        # Imported here: they load SciPy and numba, which help and completion do without.
        from ..trajectory.trajectory import Diverged, SolverFailure, Unfinished

        if not isinstance(error, (Diverged, SolverFailure, Unfinished)):
            raise
        _fail(error, 1)
    except (KeyboardInterrupt, SystemExit) as stop:
        if isinstance(stop, SystemExit) and stop.code != INTERRUPTED:
            raise
        kept = "finished parts are kept, " if TALK.kept else ""
        print(f"stiffbeam: interrupted; {kept}run the same command again", file=sys.stderr)
        if stopped:  # at once: what the compiler had half made can crash the end of the interpreter
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(128 + stopped[0])
        raise SystemExit(INTERRUPTED) from None


def _in_compiler(frame: FrameType | None) -> bool:
    """True within a call of LLVM. An exception in its callbacks would lose machine code, and calls of that code would
    end with a segmentation fault."""
    while frame is not None and Path(frame.f_code.co_filename).name != "executionengine.py":
        frame = frame.f_back
    return frame is not None


def _fail(error: Exception, status: int) -> NoReturn:
    print(f"stiffbeam: {error}", file=sys.stderr)
    raise SystemExit(status) from None


__all__ = ["app", "main"]
