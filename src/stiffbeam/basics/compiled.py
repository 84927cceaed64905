"""Compilation of the kernels, kept on disk so that only the first run pays for it."""

from __future__ import annotations

import gc
import hashlib
import re
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numba
from numba import types
from numba.extending import register_jitable

from . import storage
from .resources import stopped_clock
from .validation import InputError

# Sums may be reassociated and contracted, but NaN and inf stay honest: an overflow must be seen.
FASTMATH = {"reassoc", "contract"}
IMPORT = re.compile(r"^ *from (\.+)([\w.]+) import", re.MULTILINE)
LONG = 1.0  # seconds of compiling, after which there is garbage


def compiled(function: Callable[..., Any]) -> Any:
    """``function`` compiled by numba on its first call, cached in the cache directory; it holds no GIL."""
    return _njit(function)


def inner(function: Callable[..., Any]) -> Any:
    """``function`` compiled for other kernels alone: what Python needs to call it would take a tenth of the time."""
    return _from_kernels_alone(_njit(function, no_cpython_wrapper=True))


def in_order(function: Callable[..., Any]) -> Any:
    """``function`` compiled with every sum in the written order. Use it if a later term restores what an earlier one
    rounded off."""
    return _njit(function, fastmath={"contract"})


def inlined(function: Callable[..., Any]) -> Any:
    """``function`` compiled once and inserted as machine code at every call, for inner loops that pass arrays to it.

    It makes no arrays and returns none, so that it need not count references to those it is given, which takes locked
    instructions. Of numbers alone ``compiled`` is as fast.
    """
    return _njit(function, forceinline=True, _nrt=False)


def inner_inlined(function: Callable[..., Any]) -> Any:
    """``inlined`` for other kernels alone."""
    return _from_kernels_alone(_njit(function, forceinline=True, _nrt=False, no_cpython_wrapper=True))


def formula(function: Callable[..., Any]) -> Callable[..., Any]:
    """``function`` unchanged, which kernels can call too: arithmetic that works on numbers, NumPy and JAX arrays."""
    return register_jitable(fastmath=FASTMATH, error_model="numpy")(function)


class CFunction:
    """A function that C can call. It is compiled at the first use of ``address`` and cached like the kernels."""

    def __init__(self, function: Callable[..., Any], signature: Any) -> None:
        self.__doc__, self.function, self.signature = function.__doc__, function, signature

    @cached_property
    def made(self) -> Any:
        """The compiled function, which has to outlive every use of its address."""
        # The options of ``_njit``, so that a C function computes what a kernel does.
        options: dict[str, Any] = {"error_model": "numpy", "fastmath": FASTMATH}
        with stopped_clock(), _cache_of(self.function):
            try:
                return numba.cfunc(self.signature, cache=True, **options)(self.function)
            except Exception:  # whatever unpickling makes of a damaged file
                return numba.cfunc(self.signature, **options)(self.function)

    @property
    def address(self) -> int:
        """Address of the machine code."""
        return self.made.address


def called_from_c(signature: Any) -> Callable[[Callable[..., Any]], CFunction]:
    """``function`` compiled for C with this signature."""
    return lambda function: CFunction(function, signature)


@lru_cache
def directory(file: Path) -> Path:
    """Folder of the compiled kernels of a source file. Each version of the file and of its imports has its own folder.

    numba itself looks at the file of the function it compiles, not at those of the functions in it, nor at whether
    bounds are checked.
    """
    # Code with bounds checks is other code.
    digest = hashlib.sha256(b"bounds" if numba.config.BOUNDSCHECK else b"")  # type: ignore[attr-defined]
    for source in sorted(_sources(file)):
        digest.update(source.read_bytes())
    return storage.directory() / "numba" / digest.hexdigest()[:16]


@lru_cache
def _sources(file: Path) -> frozenset[Path]:
    """A file and the files with compiled functions that it imports from, directly or through others."""
    sources = {file}
    for dots, module in IMPORT.findall(file.read_text(encoding="utf-8")):
        # The file of a relative import: one dot is the file's folder.
        imported = file.parents[len(dots) - 1].joinpath(*module.split(".")).with_suffix(".py")
        # Only a file that imports from ``compiled`` holds functions that become part of kernels.
        if imported.is_file() and "compiled import" in imported.read_text(encoding="utf-8"):
            sources |= _sources(imported)
    return frozenset(sources)


def _forgiving(kernel: Any) -> Any:
    """A kernel that is compiled again if its file is damaged, and that is used even if it cannot be stored.

    numba takes only a missing file as none: an index that is cut or full of zeros ended every later run.
    """
    kept = kernel._cache
    load, save, flush = kept.load_overload, kept.save_overload, kept.flush

    def load_overload(*arguments: Any) -> Any:
        try:
            return load(*arguments)
        except Exception:  # whatever unpickling makes of a damaged file
            with suppress(OSError):
                # Deleted, so that no later run reads the damaged file.
                flush()
            return None

    def save_overload(*arguments: Any) -> None:
        # A cache that cannot be written to costs time, not the run.
        with suppress(OSError):
            save(*arguments)

    kept.load_overload, kept.save_overload = load_overload, save_overload
    return kernel


def _one_program(kernel: Any) -> Any:
    """A kernel that is compiled once for all constants. Otherwise numba treats each constant argument as a type."""
    template = kernel.get_call_template

    def get_call_template(args: Any, kws: Any) -> Any:
        return template([types.unliteral(arg) for arg in args], {k: types.unliteral(arg) for k, arg in kws.items()})

    kernel.get_call_template = get_call_template
    return kernel


def _from_kernels_alone(kernel: Any) -> Any:
    """A kernel without an entry for Python: a call from there raises TypeError, where numba would jump to address 0."""

    def refuse(*_: Any, **__: Any) -> Any:
        raise TypeError(f"{kernel.__name__} is compiled for other kernels, which alone can call it")

    kernel._insert, kernel._compile_for_args = lambda *_: None, refuse
    return kernel


def _without_collections(kernel: Any) -> Any:
    """A kernel that is compiled without garbage collection, which would find little and take a tenth of the time."""
    compile_all = kernel.compile  # with what it calls, which comes here again

    def collecting_after(signature: Any) -> Any:
        with stopped_clock():
            if not gc.isenabled():
                return compile_all(signature)
            gc.disable()
            begun = time.perf_counter()
            try:
                return compile_all(signature)
            finally:
                gc.enable()
                if time.perf_counter() - begun > LONG:
                    gc.collect(0)  # here, and not at the first array of a run; all of it is young

    kernel.compile = collecting_after
    return kernel


def _njit(function: Callable[..., Any], **options: Any) -> Any:
    disabled = numba.config.DISABLE_JIT  # type: ignore[attr-defined]
    if disabled:  # in Python a division by zero would raise where a kernel goes on with inf
        raise InputError("NUMBA_DISABLE_JIT", disabled, "be unset or 0", "numba compiles stiffbeam's kernels")
    with _cache_of(function):
        chosen: dict[str, Any] = {"fastmath": FASTMATH, **options}
        # No function is handed to another as an argument, so none needs what C would call.
        chosen |= {"cache": True, "nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
        kernel = numba.njit(**chosen)(function)
        return _without_collections(_forgiving(_one_program(kernel)))


@contextmanager
def _cache_of(function: Callable[..., Any]) -> Generator[None, None, None]:
    """Keep what numba compiles in this context in the cache of the function's file."""
    before = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    numba.config.CACHE_DIR = str(directory(Path(function.__code__.co_filename)))  # type: ignore[attr-defined]
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before  # type: ignore[attr-defined]
