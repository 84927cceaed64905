"""SIGINT and SIGTERM at every command that takes long: a line says how to go on, and the same command ends as ever."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import typer
from measured import settled
from processes import nobody_left, session

from stiffbeam.cli import app
from stiffbeam.studies import STUDIES

SHORT = {"cases", "doctor"}  # they only tell what there is
SAID = "stiffbeam: interrupted; run the same command again\n"
KEPT = "stiffbeam: interrupted; finished parts are kept, run the same command again\n"
STATUS = {signal.SIGINT: 130, signal.SIGTERM: 143}
COMMANDS: dict[str, list[str]] = {
    "compare": ["compare", "table10", "--t-end", "0.2", "--references", "cvode,exact", "--no-cache", "--out", "out"],
    "reference": ["reference", "table10", "--method", "multiprecision", "--t-end", "0.2", "--out", "out/r.nc"],
    "advise": ["advise", "table10", "--t-end", "0.3", "--schemes", "HHT(alpha=-0.1)"],
    "doubt": ["doubt", "table10", "--uncertain", "stiffness=297:303", "--members", "16"],
    "animate": ["animate", "table10", "--t-end", "0.2", "--seconds", "2", "--out", "out/film.gif"],
    "score": ["score", "HHT(alpha=-0.1)", "--problem", "bilinear-gap,bouncing-bar,bilinear-oscillator"],
    "reproduce": ["reproduce", "table", "17", "--out", "out"],
    "studies": ["studies", "table10", "--smoke", "--jobs", "2", "--out", "out"],
    "sweep": ["sweep", "table10", "--parameter", "frequency", "--values", "8:14:40", "--jobs", "2", "--out", "out"],
    **{name.replace("_", "-"): [name.replace("_", "-"), "table10", "--smoke", "--out", "out"] for name in STUDIES
       if name != "sweep"},
}  # fmt: skip
KEEPING = {"advise", "reproduce", "studies", *(name.replace("_", "-") for name in STUDIES)}
AT_ONCE = {"score", "reference", "advise"}  # a phase is half of it
OFTEN = ("compare", "reference", "sweep")


def test_every_command_is_here_or_takes_no_time():
    assert set(COMMANDS) | SHORT == set(typer.main.get_command(app).list_commands(None))  # type: ignore[attr-defined]


def begun(name: str, folder: Path) -> subprocess.Popen[str]:
    """The command at work in a folder of its own, with an empty one for what is temporary."""
    (folder / "tmp").mkdir(parents=True, exist_ok=True)
    words = [sys.executable, "-m", "stiffbeam", *COMMANDS[name], "--verbose", "--json", "found.json"]
    return subprocess.Popen(
        words, cwd=folder, env=os.environ | {"TMPDIR": str(folder / "tmp")}, stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip


def ended(name: str, folder: Path) -> dict:
    """What the command finds where nobody disturbs it."""
    child = begun(name, folder)
    said = child.communicate(timeout=600)[1]
    assert child.returncode in (0, 1), said  # 1: a score may be flagged
    found = json.loads((folder / "found.json").read_text())
    if name == "studies":
        return found | {"studies": [settled(one) for one in found["studies"]]}
    if name == "reference":
        return {"references": [settled(one) for one in found["references"]]}
    return settled(found) if "measured" in found else found


def interrupted(name: str, folder: Path, number: signal.Signals, phases: int) -> str:
    """What the command says where a signal comes as its phase of that number begins."""
    child, heard = begun(name, folder), []
    assert child.stderr is not None

    def listen(stream=child.stderr) -> None:
        heard.extend(iter(stream.readline, ""))

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    try:
        while len(heard) < phases and child.poll() is None:
            time.sleep(0.02)
        (os.killpg if number == signal.SIGINT else os.kill)(child.pid, number)  # Ctrl-C goes to all of them
        child.wait(60)
    finally:  # one that does not hear must not hold up the tests behind it
        child.kill()
        nobody_left(child.pid)
        listener.join(20)
        child.stderr.close()
    text = "".join(heard)
    assert child.returncode == STATUS[number], text
    return text


@pytest.mark.parametrize(
    "name", [pytest.param(x, marks=pytest.mark.slow if x in OFTEN else pytest.mark.campaign) for x in COMMANDS]
)
def test_a_signal_is_answered_and_the_same_command_ends_as_without_it(name, tmp_path):
    whole = ended(name, tmp_path / "whole")
    folder = tmp_path / "stopped"
    for number, phases in ((signal.SIGINT, 1), (signal.SIGTERM, 1 if name in AT_ONCE else 2)):
        said = interrupted(name, folder, number, phases)
        assert said.endswith((SAID, KEPT) if name in KEEPING else SAID), said
        assert "Traceback" not in said
        assert not [*folder.rglob("*.partial"), *folder.rglob("tmp*.*"), *(folder / "tmp").iterdir()]
    again = ended(name, folder)
    drop = {"written", "files", "file", "page"}
    assert {k: x for k, x in again.items() if k not in drop} == {k: x for k, x in whole.items() if k not in drop}
    assert not list((folder / "tmp").iterdir())
    here, there = ({x.relative_to(root) for x in root.rglob("*")} for root in (folder, tmp_path / "whole"))
    assert here == there


@pytest.mark.slow
def test_a_second_signal_does_not_wait(tmp_path):
    child = begun("reproduce", tmp_path)
    while not session(child.pid):
        time.sleep(0.05)
    time.sleep(4.0)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGTERM):
        child.send_signal(number)
    said = child.communicate(timeout=30)[1]
    nobody_left(child.pid)
    assert child.returncode in (130, 143, -signal.SIGTERM)
    assert "Traceback" not in said


def heard(program: str, number: signal.Signals, seconds: float) -> tuple[int, str, str]:
    """Status, output and errors of a program that sends itself a signal."""
    command = [sys.executable, "-c", program.format(name=number.name)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=seconds, check=False)
    return done.returncode, done.stdout, done.stderr


LOST = """
import os, signal, time, weakref
from stiffbeam import cli

class Thing: ...

def dropped(_):
    os.kill(os.getpid(), signal.{name})
    for _ in range(10000):  # the exception comes here, where Python drops it
        pass

def app():
    thing = Thing()
    kept = weakref.ref(thing, dropped)
    del thing
    try:
        time.sleep(20)
    finally:
        time.sleep(1)
        print("cleaned up")

cli.app = app
cli.main()
"""


@pytest.mark.parametrize("number", STATUS)
@pytest.mark.fast(1)
def test_a_signal_that_comes_where_python_drops_exceptions_is_heard_all_the_same(number):
    assert heard(LOST, number, 15) == (STATUS[number], "cleaned up\n", SAID)


COMPILING = """
import os, signal
from numba import njit
from numba.core.codegen import JITCodeLibrary

hook, sent = JITCodeLibrary._object_getbuffer_hook, []

def called_by_llvm(cls, module):
    if not sent:
        sent.append(module)
        os.kill(os.getpid(), signal.{name})
        for _ in range(10000):  # an exception here is dropped, and LLVM goes on without the code
            pass
        print("returned")
    return hook(module)

JITCodeLibrary._object_getbuffer_hook = classmethod(called_by_llvm)
from stiffbeam import cli  # only now: it hands the hook to LLVM

def app():
    njit(lambda x: x + 1)(1)
    while True:  # until the signal ends it
        pass

cli.app = app
cli.main()
"""


@pytest.mark.parametrize("number", STATUS)
@pytest.mark.fast(1)
def test_a_signal_within_a_callback_of_the_compiler_waits_for_its_end(number):
    assert heard(COMPILING, number, 30) == (STATUS[number], "returned\n", SAID)
