"""The ``stiffbeam`` command."""

from __future__ import annotations

import atexit
import gc
import io
import os
import signal
import sys
import warnings
from contextlib import suppress
from types import FrameType
from typing import NoReturn

from ..basics.resources import TALK

INTERRUPTED = 130  # the exit status of a program that Ctrl-C has stopped
QUIET = ("-q", "--quiet")


def main() -> None:
    """Entry point: InputError exits with 2, a failure with 1, SIGINT with 130, SIGTERM with 143, each with one line."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # letters that an ASCII or Latin-1 terminal does not have
    os.environ.setdefault("PJRT_NPROC", "1")  # threads of JAX, which on small systems do nothing but seek work
    # Of an interrupted study joblib's clean-up would tell what it cleans.
    os.environ.setdefault("PYTHONWARNINGS", "ignore:resource_tracker")
    from cyclopts import CycloptsError

    from ..basics.validation import InputError
    from .commands import application

    stopped: list[int] = []

    def end(number: int, _: FrameType | None) -> None:
        stopped.append(number)
        for name in (signal.SIGINT, signal.SIGTERM):  # a second one does not wait
            signal.signal(name, signal.SIG_DFL)
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, end)  # as Ctrl-C: what is finished is kept
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not where a shell has it ignored
        signal.signal(signal.SIGINT, end)
    atexit.register(gc.freeze)  # at the end a search through all modules for garbage would only take time
    given = sys.argv[1:]
    words = [word for word in given if word not in QUIET]
    TALK.quiet = words != given
    warnings.showwarning = lambda message, *_, **__: print(f"stiffbeam: warning: {message}", file=sys.stderr)
    try:
        app = application(next((word for word in words if not word.startswith("-")), ""))
        status = app(words or ["--help"], exit_on_error=False, print_error=False)
        sys.stdout.flush()  # a full disk is an error of the command
    except InputError as error:
        _fail(error, 2)
    except CycloptsError as error:
        cause = error.__cause__
        _fail(cause if isinstance(cause, InputError) else f"{' '.join(str(error).split())} See stiffbeam --help", 2)
    except OSError as error:
        with suppress(OSError):
            sys.stdout.flush()
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the interpreter does not try a full disk again
        _fail(error, 1)
    except RuntimeError as error:
        # Imported here: they load SciPy, which help does without.
        from ..trajectory.trajectory import Diverged, SolverFailure, Unfinished

        if not isinstance(error, (Diverged, SolverFailure, Unfinished)):
            raise
        _fail(error, 1)
    except KeyboardInterrupt:
        print("stiffbeam: interrupted; finished parts are kept, run the same command again", file=sys.stderr)
        if stopped:  # at once: worker processes end with this one
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(128 + stopped[0])
        raise SystemExit(INTERRUPTED) from None
    raise SystemExit(status if isinstance(status, int) else 0)


def _fail(error: Exception | str, status: int) -> NoReturn:
    print(f"stiffbeam: {error}", file=sys.stderr)
    raise SystemExit(status) from None
