"""Many machines: the workers of a Dask scheduler as an executor for ``run_study``."""

from __future__ import annotations

import os
from collections.abc import Generator
from concurrent.futures import CancelledError, Executor
from contextlib import contextmanager
from typing import Any

from ...basics.storage import source_hash
from ...basics.validation import InputError
from ...trajectory.trajectory import Unfinished
from .runner import GO_ON

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
