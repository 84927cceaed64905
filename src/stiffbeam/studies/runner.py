"""Run a study: its points one by one, on processes or on a Dask scheduler. A journal keeps the finished ones."""

from __future__ import annotations

import hashlib
import inspect
import json
import multiprocessing
import os
import pickle
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import closing, contextmanager, nullcontext
from importlib.metadata import version
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..basics.resources import TALK, Show, cores, displayed
from ..basics.storage import source_hash
from ..basics.validation import InputError, integer
from ..files.cases import Case, case_of, find_case
from ..model.system import System
from ..references.registry import REFERENCES
from ..schemes import Scheme
from ..schemes.labels import user_source
from ..testset.integrators import integrator
from ..trajectory.trajectory import Diverged, SolverFailure, Trajectory, Unfinished
from .interface import FEW, Batch, Point, Records, Row, Study, Table, scalar

try:
    import fcntl
except ImportError:  # where there is no such lock
    fcntl = None

LISTED = 10_000  # rows that records hold as a list; more stay in columns
DEATHS = 3  # of processes without a point in between, until it is given up
_ALONE = threading.Lock()  # a process evaluates one point at a time, whatever executor it belongs to


def run_study(
    study: Study,
    case: Case | System | str,
    folder: str | Path | None = None,
    jobs: int = 1,
    executor: Executor | None = None,
    progress: bool | Show = False,
    **options: Any,
) -> Records:
    """Evaluate every point of ``study`` on ``case``; with a System ``dt`` and ``t_end`` have to be given.

    folder: folder of the journal of finished points; a second run with the same folder computes the missing ones only.
    jobs: processes to use, unless an ``executor`` is given; a study that measures time runs point by point in any case.
    progress: True shows a bar; a function is called as show(what, done, total).
    options: the study's own, see its ``points``. A point that fails is a row with ``failed``, one that is not possible
    a row with ``refused``, each with the reason. Raises InputError, also for a case that cannot be sent to processes,
    and Unfinished if those keep dying.
    """
    if not callable(progress):
        with displayed(progress) as show:
            return run_study(study, case, folder, jobs, executor, show, **options)
    known = [name for name in inspect.signature(study.points).parameters if name != "case"]
    if isinstance(case, System):
        dt, t_end = (options.get(x) if x in known else options.pop(x, None) for x in ("dt", "t_end"))
        case = case_of(case, dt, t_end)
    case = find_case(case) if isinstance(case, str) else case
    if not isinstance(case, Case):
        remedy = "for example 'table10'"
        raise InputError("case", type(case).__name__, "be a case, its name, a case file, or a System", remedy)
    integer("jobs", jobs, 1)
    options = {name: value.tolist() if hasattr(value, "tolist") else value for name, value in options.items()}
    cores()  # what is wrong with STIFFBEAM_THREADS is wrong at every point
    begun = time.perf_counter()
    progress(f"{study.command}: planning", 0, 0)
    points = study.plan(case, **options)
    journal = Journal(None if folder is None else Path(folder), study.name, case)
    missing = [point for point in points if journal.part(point) is None]
    finished = len(points) - len(missing)
    with journal if missing else nullcontext():
        progress(study.command, finished, len(points))
        with closing(_evaluate_all(study, case, missing, jobs, executor)) as results:  # ends the processes too
            for point, rows in results:
                journal.keep(point, rows)
                finished += 1
                progress(study.command, finished, len(points))
    table = Table(journal.part(point) or [] for point in points)
    rows = table if len(table) > LISTED else list(table)
    options = {name: _as_text(value, name == "schemes") for name, value in options.items()}
    return Records(study, case, options, rows, time.perf_counter() - begun)


def _as_text(value: Any, schemes: bool = False) -> Any:
    """An option with the labels of integrators in the place of these, and of their names among ``schemes``."""
    if isinstance(value, (list, tuple)):
        return [_as_text(item, schemes) for item in value]
    named = schemes and isinstance(value, str)
    return integrator(value).label if named or callable(value) or isinstance(value, (Scheme, Trajectory)) else value


def _evaluate_all(
    study: Study, case: Case, points: list[Point], jobs: int, executor: Executor | None
) -> Generator[tuple[Point, list[Row]], None, None]:
    """Here, on the executor, or on processes of our own; points as they are finished."""
    if study.measured or len(points) < 2 or (executor is None and jobs == 1):
        for point in points:
            yield point, evaluate_point(study.evaluate, case, point)
    else:
        _require_portable(study, case, points)
        if executor is None:
            main = sys.modules["__main__"]
            source = None if main.__spec__ else getattr(main, "__file__", None)
            if source and not os.path.isfile(source):  # each process would read it
                remedy = "save the script as a file, or use jobs=1"
                raise InputError("jobs", jobs, f"be 1 in a script read from {source}", remedy)
            yield from _on_processes(study, case, points, jobs)
            return
        lost = yield from _gather(executor, study, case, points)
        if lost:
            raise Unfinished(f"the executor lost {len(lost)} points of {study.name}: {GO_ON}")


def _require_portable(study: Study, case: Case, points: list[Point]) -> None:
    """Raise InputError for what cannot be sent to another process, before any is started: a pool would wait for
    ever."""
    remedy = "use jobs=1, or functions at the top of a module of their own in place of a lambda"
    rule = "travel to other processes"
    try:
        sent = pickle.dumps((study.evaluate, case))
    except Exception as error:  # whatever the objects of others raise when they are pickled
        raise InputError("case", f"{case.name}: {error}", rule, remedy) from None
    if os.path.isfile(getattr(sys.modules["__main__"], "__file__", None) or ""):
        return
    if b"__main__" in sent:
        raise InputError("case", f"{case.name} with a function of a session without a file", rule, remedy)
    labels = (x for point in points for x in point.values() if isinstance(x, str))
    if label := next((x for x in labels if x.startswith("__main__:")), ""):
        raise InputError("schemes", label, rule, remedy)


def _on_processes(study: Study, case: Case, points: list[Point], jobs: int) -> Iterator[tuple[Point, list[Row]]]:
    """Rows from processes that share the cores. If one is killed, new ones compute the missing points.

    Never threads: SUNDIALS solvers do not share one.
    """
    deaths = 0
    while points:
        workers = min(jobs, len(points))
        threads = max(1, cores() // workers)
        with processes(workers, threads) as pool:
            lost = yield from _gather(pool, study, case, points, threads)
        # A death may be chance as long as some points are finished; several in a row without any are not.
        deaths = deaths + 1 if len(lost) == len(points) else 0
        if deaths == DEATHS:
            reason = 'is there enough memory, and does a script call it under if __name__ == "__main__"?'
            raise Unfinished(f"a process of {study.name} died {deaths} times in a row: {reason} {GO_ON}")
        points = lost


def _gather(
    pool: Executor, study: Study, case: Case, points: list[Point], threads: int = 0
) -> Generator[tuple[Point, list[Row]], None, list[Point]]:
    """Points as they are finished; returns those that were lost with their process.

    threads: of the BLAS in processes that this call starts, 0 where it starts none.
    """
    lost = []
    futures: dict[Future[Any], Point] = {}
    try:
        with starting(threads) if threads else nullcontext():
            for point in points:
                futures[pool.submit(evaluate_point, study.evaluate, case, point)] = point
    except BrokenExecutor:
        # The pool broke while points were being sent: those not sent are lost too.
        lost = points[len(futures) :]
    for future in as_completed(futures):
        if isinstance(future.exception(), BrokenExecutor):
            lost.append(futures[future])
        else:
            yield futures[future], future.result()
    return lost


def evaluate_point(evaluate: Callable[[Case, Point], list[Row]], case: Case, point: Point) -> list[Row]:
    """The rows at one point, each with the point's own entries but lists; a failure as a row."""
    with _ALONE:
        try:
            rows = evaluate(case, point)
        except InputError as error:  # what cannot be asked here: an answer, and the same the next time
            rows = [{"refused": str(error)}]
        except (Diverged, SolverFailure) as error:
            rows = [{"failed": str(error)}]
        except (ArithmeticError, np.linalg.LinAlgError) as error:
            rows = [{"failed": f"{type(error).__name__}: {error}"}]
    entries = {name: value for name, value in point.items() if not isinstance(value, list)}
    return [entries | row for row in rows]


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
    # Processes that start in the block inherit the mask, which ``begin_worker`` lifts.
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
        # The result has no reader any more. ``sys.exit`` would end this thread only.
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


GO_ON = "run the same command again; with a folder the finished points are kept"
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


class Journal:
    """Journal file with one line per finished point and its checksum, appended and flushed: its rows, or their columns
    if they are many. Lines that are cut short by a kill or do not match their checksum are ignored. As a context
    manager it is locked: no other process works on it.

    The file's name holds a hash of study, physics, grid, step, span and the package's source: a journal
    of anything else is never read, and never overwritten.
    """

    def __init__(self, folder: Path | None, study: str, case: Case) -> None:
        self.file = None if folder is None else folder / f"{study}-{_digest(study, case)}.jsonl"
        self.finished: dict[str, list[Row] | Batch] = {}
        self._lock: IO[str] | None = None
        if self.file is None:
            return
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            self.file.touch()
        except OSError as error:
            rule = "lie in a folder that can be written to"
            raise InputError("journal", str(self.file), rule, f"{error.strerror}: name another") from None
        if self.file.is_file():
            text = self.file.read_bytes()
            # A kill may cut the last line short.
            whole = text[: text.rfind(b"\n") + 1]
            for line in whole.splitlines():
                try:
                    entry = json.loads(line)
                    if entry.pop("sum") != _sum(entry):
                        continue
                    point, source = entry["point"], entry.get("source", "")
                    rows = Batch.from_json(entry["table"]) if "table" in entry else entry["rows"]
                except (ValueError, KeyError, TypeError):
                    continue  # a damaged line: its point is evaluated again
                if source != _source(point):
                    continue  # a scheme of one's own that has changed since
                if not all("failed" in row for row in rows):  # what failed may work now
                    self.finished[_key(point)] = rows
            TALK.kept |= bool(self.finished)
            if len(whole) < len(text):
                os.truncate(self.file, len(whole))  # never rewritten: a kill here must not lose the rest

    def rows(self, point: Point) -> list[Row] | None:
        """The rows of a finished point, None if it is not evaluated yet."""
        rows = self.part(point)
        return None if rows is None else list(rows)

    def part(self, point: Point) -> list[Row] | Batch | None:
        """The rows of a finished point as they are kept, None if it is not evaluated yet."""
        return self.finished.get(_key(point))

    def keep(self, point: Point, rows: list[Row]) -> list[Row] | Batch:
        """Record a finished point and return its rows as a later run will read them."""
        entry: dict[str, Any] = {"point": point}
        if source := _source(point):
            entry["source"] = source
        # Through JSON, so that this run returns the rows that a resumed one reads.
        if len(rows) < FEW:
            entry = json.loads(json.dumps(entry | {"rows": rows}, default=scalar))
            kept = entry["rows"]
        else:
            kept = Batch.of(rows)
            if self.file is not None:
                entry = json.loads(json.dumps(entry | {"table": kept.to_json()}, default=scalar))
        if self.file is not None:
            try:
                with self.file.open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps(entry | {"sum": _sum(entry)}) + "\n")
            except OSError as error:
                remedy = f"{error.strerror}; finished points are kept, run the same command again"
                raise InputError("journal", str(self.file), "be a file that can be written to", remedy) from None
            TALK.kept = True
        self.finished[_key(point)] = kept
        return kept

    def __enter__(self) -> Journal:
        """Raises InputError where another process holds the journal."""
        if self.file is not None and fcntl is not None:
            self._lock = self.file.with_suffix(".lock").open("a+")
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                self._lock.seek(0)
                who = self._lock.read().strip() or "another process"
                self._lock.close()
                remedy = "wait for it, or give this one another folder"
                raise InputError("journal", str(self.file), f"be free, and {who} works on it", remedy) from None
            self._lock.truncate(0)
            self._lock.write(f"process {os.getpid()} of {socket.gethostname()}\n")
            self._lock.flush()
        return self

    def __exit__(self, *_: object) -> None:
        if self._lock is not None:
            self._lock.close()  # which frees it, as the end of the process would
            self._lock = None


def _sum(entry: dict[str, Any]) -> str:
    """A checksum of an entry, whatever the order of its names."""
    return hashlib.sha256(json.dumps(entry, sort_keys=True).encode()).hexdigest()[:16]


def _key(point: Point) -> str:
    return json.dumps(point, sort_keys=True, default=scalar)


def _source(point: Point) -> str:
    """Return the source text of the modules of a user's schemes in a point."""
    labels = [value for value in point.values() if isinstance(value, str) and ":" in value]
    return "".join(user_source(label) for label in labels if label not in REFERENCES)


def _digest(study: str, case: Case) -> str:
    runs = [f"{scheme}@{form}" for scheme, form in case.runs]
    physics = f"{case.system().fingerprint} {case.grid} {case.dt!r} {case.t_end!r}"
    content = f"{study} {physics} {runs} {version('stiffbeam')}"
    return hashlib.sha256(f"{content} {source_hash()}".encode()).hexdigest()[:12]
