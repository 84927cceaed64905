"""Sweeps that are stopped, killed, and spread over processes and Dask workers."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.studies import find_study, study
from stiffbeam.studies.runner import run_study
from stiffbeam.trajectory.trajectory import Unfinished

SHORT = {"periods": 3, "transient": 2}


TABLE10 = sb.paper_case(10)


MANY = {"parameter": "clearance", "values": np.linspace(0.06, 0.12, 32).tolist(), "dt": 5e-4, **SHORT}


@pytest.fixture(scope="module")
def serial() -> list[dict]:
    return study("sweep", TABLE10, **MANY).rows


def journal_lines(folder) -> int:
    files = list(folder.glob("sweep-*.jsonl"))
    return len(files[0].read_bytes().splitlines()) if files else 0


def test_an_interrupted_sweep_goes_on_where_it_stopped(tmp_path, serial):
    def stop(_what, done, _total):
        if done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(find_study("sweep"), TABLE10, tmp_path, progress=stop, **MANY)
    assert journal_lines(tmp_path) == 5
    journal = next(tmp_path.glob("sweep-*.jsonl"))
    whole = journal.read_bytes()
    journal.write_bytes(whole + b'{"point": {"parameter": "clear')  # the line that a kill has cut
    steps = []
    records = run_study(
        find_study("sweep"), TABLE10, tmp_path, progress=lambda what, done, total: steps.append(done), **MANY
    )
    assert steps[1:3] == [5, 6]
    assert journal.read_bytes().startswith(whole)
    assert records.rows == serial


def die_once(case, point):
    """The study's own evaluation; the process that takes the third point first gets SIGKILL in the middle."""
    if point["values"][0][0] == MANY["values"][4] and not os.path.exists(os.environ["STIFFBEAM_TEST_KILLED"]):
        with open(os.environ["STIFFBEAM_TEST_KILLED"], "x"):
            os.kill(os.getpid(), signal.SIGKILL)
    return find_study("sweep").evaluate(case, point)


def die(_case, _point):
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.slow
def test_two_processes_find_what_one_does_and_one_may_be_killed(tmp_path, serial, monkeypatch):
    """SIGKILL on a worker in the middle of a batch: a new pool does what is missing."""
    monkeypatch.setenv("STIFFBEAM_TEST_KILLED", str(tmp_path / "killed"))
    records = run_study(replace(find_study("sweep"), evaluate=die_once), TABLE10, tmp_path, jobs=2, **MANY)
    assert (tmp_path / "killed").exists()
    assert records.rows == serial
    assert journal_lines(tmp_path) == 16, "no batch was done twice"


@pytest.mark.slow
def test_a_pool_that_keeps_dying_is_given_up_and_says_how_to_go_on(tmp_path):
    with pytest.raises(Unfinished, match="run the same command again"):
        run_study(replace(find_study("sweep"), evaluate=die), TABLE10, tmp_path, jobs=2, **MANY)


SCRIPT = """
import stiffbeam as sb
sb.study("modes", "table10", schemes=["BDF2", "SDIRK"], jobs=2, dt=1e-3)
"""


def test_a_script_read_from_a_pipe_is_told_to_use_one_process():
    """No process could read it again: before, they died one after the other, for want of memory it was said."""
    done = subprocess.run([sys.executable, "-"], input=SCRIPT, capture_output=True, text=True, timeout=300)
    assert "jobs must be 1 in a script read from <stdin>, got 2: save the script as a file" in done.stderr


@pytest.mark.slow
def test_a_script_whose_processes_call_it_again_is_told_how_to_write_it(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=300)
    assert 'does a script call it under if __name__ == "__main__"?' in done.stderr.splitlines()[-1]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks for the children in /proc")
def test_a_sweep_whose_process_is_killed_loses_no_finished_point(tmp_path, serial):
    """SIGKILL on the driving process: its workers end too, and the same command does the rest only."""
    command = [
        sys.executable, "-m", "stiffbeam", "sweep", "table10", "--parameter", "clearance", "--values",
        "0.06:0.12:32", "--dt", "5e-4", "--periods", "3", "--transient", "2", "--out", str(tmp_path), "--jobs", "2",
    ]  # fmt: skip
    driver = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    folder = tmp_path / "journal"
    end = time.monotonic() + 120.0
    while journal_lines(folder) < 2 and time.monotonic() < end:
        time.sleep(0.005)
    children = children_of(driver.pid)
    driver.kill()
    driver.wait()
    kept = journal_lines(folder)
    assert kept >= 2
    assert children
    assert not (tmp_path / "sweep-clearance.json").exists()
    while any(alive(child) for child in children) and time.monotonic() < end:
        time.sleep(0.05)
    assert not any(alive(child) for child in children)
    before = next(folder.glob("*.jsonl")).read_bytes()
    whole = before[: before.rfind(b"\n") + 1]
    subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
    assert next(folder.glob("*.jsonl")).read_bytes().startswith(whole)
    assert journal_lines(folder) == 16, "a finished point would stand there twice"
    assert json.loads((tmp_path / "sweep-clearance.json").read_text())["rows"] == json.loads(json.dumps(serial))


def children_of(pid: int) -> list[int]:
    with open(f"/proc/{pid}/task/{pid}/children") as stream:
        return [int(child) for child in stream.read().split()]


def alive(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat") as stream:
            return stream.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.slow
def test_dask_workers_find_what_one_process_does_and_one_may_be_killed(tmp_path, serial, monkeypatch):
    """A local cluster of worker processes; one gets SIGKILL in the middle of a batch."""
    distributed = pytest.importorskip("distributed")
    from stiffbeam.studies.runner import scheduler

    monkeypatch.setenv("STIFFBEAM_TEST_KILLED", str(tmp_path / "killed"))
    cluster = distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0")
    with cluster, scheduler(cluster.scheduler_address) as executor:
        study = replace(find_study("sweep"), evaluate=die_once)
        records = run_study(study, TABLE10, tmp_path, executor=executor, **MANY)
    assert (tmp_path / "killed").exists()
    assert records.rows == serial
    assert journal_lines(tmp_path) == 16, "no batch was done twice"


@pytest.mark.slow
def test_dask_workers_that_keep_dying_are_given_up(tmp_path):
    distributed = pytest.importorskip("distributed")
    import dask

    from stiffbeam.studies.runner import scheduler

    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=True, dashboard_address=":0") as cluster,
        pytest.raises(Unfinished, match="run the same command again"),
        scheduler(cluster.scheduler_address) as executor,
    ):
        run_study(replace(find_study("sweep"), evaluate=die), TABLE10, tmp_path, executor=executor, **MANY)


def test_a_scheduler_that_is_not_there_is_named(monkeypatch):
    pytest.importorskip("distributed")
    from stiffbeam.studies import runner as module

    monkeypatch.setattr(module, "PATIENCE", 0.5)
    with pytest.raises(sb.InputError, match="running scheduler"), module.scheduler("tcp://127.0.0.1:9"):
        pass


def test_without_dask_the_package_is_named(monkeypatch):
    from stiffbeam.studies.runner import scheduler

    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(sb.InputError, match=r"pip install 'stiffbeam\[dask\]'"), scheduler("tcp://127.0.0.1:9"):
        pass
