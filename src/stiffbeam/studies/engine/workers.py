"""The processes of a study, their start and their end: those of this machine, and workers of a Dask scheduler."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Generator
from concurrent.futures import CancelledError, Executor, ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any

from ...basics.storage import source_hash
from ...basics.validation import InputError
from ...trajectory.trajectory import Unfinished

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def starting(threads: int) -> Generator[None, None, None]:
    """Context in which processes start with this number of BLAS threads, which the BLAS reads when it is loaded, and
    without interruption.

    The matrices are so small that its threads mostly wait for each other. Held while processes start and
    no longer: the environment belongs to everything that runs in this process.
    """
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    before = {name: os.environ.pop(name) for name in names if name in os.environ}
    os.environ.update(dict.fromkeys(names, str(threads)))
    try:
        with undisturbed():
            yield
    finally:
        for name in names:
            del os.environ[name]
        os.environ.update(before)


@contextmanager
def undisturbed() -> Generator[None, None, None]:
    """SIGINT and SIGTERM wait for the end of the block: a process that is half begun cannot be ended without a
    traceback. Those that begin in it do not hear them before ``begin_worker``."""
    if sys.platform == "win32" or threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []
    before = {number: signal.signal(number, lambda number, _: held.append(number)) for number in SIGNALS}
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        for number in held[:1]:
            signal.raise_signal(number)


@contextmanager
def processes(workers: int, threads: int) -> Generator[ProcessPoolExecutor, None, None]:
    """A pool whose processes begin as they are needed, each with so many threads, and end with the block.

    Spawned, since a forked jax or numba may hang. Where the block fails they are stopped as they are: what they
    had not finished is computed again, and nobody waits for it now.
    """
    pools: list[ProcessPoolExecutor] = []
    try:
        with undisturbed():  # a pool that is half made, or half ended, leaves its semaphores behind
            spawn = multiprocessing.get_context("spawn")
            pools.append(ProcessPoolExecutor(workers, spawn, begin_worker, (threads,)))
        yield pools[0]
        with undisturbed():
            pools[0].shutdown(cancel_futures=True)
    except BaseException:
        for pool in pools:
            for process in list((pool._processes or {}).values()):
                process.terminate()
            pool.shutdown(cancel_futures=True)
        raise


def begin_worker(threads: int) -> None:
    """A worker marches ensembles on so many threads, leaves Ctrl-C to the process that started it, and ends when that
    is gone."""
    os.environ["STIFFBEAM_THREADS"] = str(threads)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


GO_ON = "finished points are kept, run the same command again"
PATIENCE = 30  # seconds for the scheduler to answer and for a first worker


@contextmanager
def scheduler(address: str) -> Generator[Executor, None, None]:
    """An executor on the workers at ``address``, e.g. ``tcp://host:8786``.

    Start them with ``dask scheduler`` and, on every machine, ``dask worker tcp://host:8786 --nworkers N
    --nthreads K``, N K its cores: a worker process evaluates one point at a time, an ensemble on K
    threads. What a worker that dies had not finished goes to another. Raises InputError where there is
    no Dask, no scheduler, no worker or another stiffbeam, and Unfinished where workers keep dying.
    """
    try:
        from distributed import Client, KilledWorker, WorkerPlugin
        from distributed.comm.core import CommClosedError
    except ImportError:
        raise InputError(
            "scheduler", address, "find Dask distributed installed", "pip install 'stiffbeam[dask]'"
        ) from None

    class Share(WorkerPlugin):
        """Every worker, also one that joins later, gives an ensemble the threads it has."""

        def setup(self, worker: Any) -> None:
            os.environ["STIFFBEAM_THREADS"] = str(worker.state.nthreads)

    try:
        client = Client(address, timeout=PATIENCE)
    except (OSError, ValueError) as error:
        remedy = f"start one with: dask scheduler ({error})"
        raise InputError("scheduler", address, "be the address of a running scheduler", remedy) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError:
            remedy = f"start one with: dask worker {address} --nthreads 1"
            raise InputError("scheduler", address, "have a worker", remedy) from None
        hashes: Any = client.run(source_hash)
        for worker, theirs in hashes.items():
            if theirs != source_hash():
                raise InputError("worker", worker, "run the same stiffbeam", "install this version there")
        client.register_plugin(Share(), name="stiffbeam threads")
        try:
            yield client.get_executor(pure=False)
        except (KilledWorker, CancelledError, CommClosedError) as error:
            raise Unfinished(
                f"the workers of {address} were lost ({str(error) or type(error).__name__}): {GO_ON}"
            ) from None
