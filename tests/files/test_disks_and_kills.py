"""Full disks, folders of others, texts, terminals, kills: what was finished stays, and a clear line says the rest."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from commands import invoke
from fuzz import STEEL

import stiffbeam as sb
from stiffbeam.cli import file_name

FULL = """
import resource, sys
import numpy as np
import stiffbeam as sb
run = sb.Trajectory.from_arrays(np.linspace(0.0, 1.0, 20001), np.random.default_rng(1).normal(size=20001))
figure = run.plot()
from stiffbeam.figures.chart import save_figure
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
for suffix in ("nc", "csv", "png"):
    try:
        save = save_figure if suffix == "png" else type(run).save
        save(figure if suffix == "png" else run, f"{sys.argv[1]}/file.{suffix}")
    except sb.InputError as error:
        print(error)
"""


@pytest.mark.slow
def test_a_disk_without_room_is_one_clear_line_and_what_was_there_stays(tmp_path):
    """A limit of 4 kB a file stands for the full disk; HDF5 itself ends in a segmentation fault there."""
    names = [f"file.{suffix}" for suffix in ("nc", "csv", "png")]
    for name in names:
        (tmp_path / name).write_text("before")
    done = subprocess.run([sys.executable, "-c", FULL, str(tmp_path)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == len(names)
    assert all("with room" in line and "what was there is as it was" in line for line in lines)
    assert sorted(x.name for x in tmp_path.iterdir()) == sorted(names)
    assert {x.read_text() for x in tmp_path.iterdir()} == {"before"}


@pytest.mark.slow
@pytest.mark.parametrize("words", [
    ["compare", "table10", "--t-end", "0.01", "--references", "exact"], ["converge", "table10"],
    ["study", "energy", "table10"], ["study", "modes", "table10"],
    ["reference", "table10", "--t-end", "0.01", "--method", "exact"],
], ids=" ".join)  # fmt: skip
def test_a_folder_that_cannot_be_written_to_is_refused(words, tmp_path):
    (tmp_path / "file").write_text("no folder")
    done = invoke([*words, "--out", tmp_path / "file" / "out"])
    assert isinstance(done.exception, sb.InputError), done.exception


def test_what_is_wrong_at_every_point_is_said_at_once(monkeypatch):
    monkeypatch.setenv("STIFFBEAM_THREADS", "abc")
    with pytest.raises(sb.InputError, match="STIFFBEAM_THREADS must be a number > 0, got 'abc'"):
        sb.study("modes", "table10", schemes=["bdf2"], steps=10)


@pytest.mark.slow
def test_names_and_titles_stay_in_their_folder_and_their_line(tmp_path, monkeypatch):
    for label in ("..", "../x", ".", "", "a/../../b", "x" * 500, ".hidden"):
        name = file_name(label)
        assert name not in ("", ".", "..")
        assert "/" not in name
        assert len(name) <= 100
    monkeypatch.chdir(tmp_path)
    text = STEEL.replace('name = "steel"', 'name = ".."').replace("a steel strip", "[/] [red]$x_ $ :smile:")
    (tmp_path / "odd.toml").write_text(text)
    done = invoke(["compare", "odd.toml", "--references", "cvode"])
    assert done.exception is None, done.exception
    assert "[/] [red]$x_ $ :smile:" in done.stdout
    assert {x.name for x in tmp_path.iterdir()} == {"odd.toml", "stiffbeam-output"}
    (tmp_path / "steered.toml").write_text(STEEL.replace("a steel strip", "\\u001b[2J"))
    with pytest.raises(sb.InputError, match="title must hold printable letters"):
        sb.load_cases(tmp_path / "steered.toml")


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_a_terminal_of_few_letters_has_the_whole_table(encoding):
    words = ["compare", "table10", "--t-end", "0.01", "--schemes", "hht", "--references", "exact"]
    done = subprocess.run([sys.executable, "-m", "stiffbeam", *words], capture_output=True, timeout=300, check=False,
                          env=os.environ | {"PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"})  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "HHT" in done.stdout.decode(encoding)


# ---------------------------------------------------------------- kills

COMMAND = ["study", "modes", "table10", "--schemes", "bdf2,bathe,trapezoidal,SDIRK(gamma=0.4359)", "--jobs", "1"]


def begun(folder: Path) -> subprocess.Popen[bytes]:
    words = [sys.executable, "-m", "stiffbeam", *COMMAND, "--out", str(folder)]
    return subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True)


@pytest.mark.parametrize(
    "wanted", [pytest.param(2, marks=pytest.mark.slow), pytest.param(100, marks=pytest.mark.campaign)]
)
def test_kills_lose_no_finished_point(wanted, tmp_path):
    """SIGKILL, SIGTERM and SIGINT at any time of a command that goes on in one folder, until it ends as without any."""
    rng, folder, kills, ends, most = random.Random(2), tmp_path / "killed", 0, 0, 0
    start = time.monotonic()
    begun(tmp_path / "whole").communicate(timeout=600)
    longest, whole = time.monotonic() - start, (tmp_path / "whole" / "modes.csv").read_text()
    while kills < wanted or not ends:
        before, child = len(list(folder.glob("points/*.json"))), begun(folder)
        try:
            child.wait(rng.uniform(0.3, 1.2) * longest)
        except subprocess.TimeoutExpired:
            child.send_signal(rng.choice([signal.SIGKILL, signal.SIGTERM, signal.SIGINT]))
            kills += 1
        child.communicate(timeout=600)
        points = list(folder.glob("points/*.json"))
        assert len(points) >= before
        most = max(most, len(points))
        if child.returncode == 0:
            ends += 1
            assert (folder / "modes.csv").read_text() == whole
            assert not list(folder.rglob("*.partial"))
            for file in [*points, *folder.glob("modes.*")]:
                file.unlink()
    assert most > 1  # there was something to lose
