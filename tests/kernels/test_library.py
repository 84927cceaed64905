"""The library of the kernels: built from its sources, guarded against wrong arrays, within its memory."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.kernels import compile as compilation
from stiffbeam.kernels.library import address
from stiffbeam.kernels.march import contact_forces, states

TESTS = Path(__file__).parents[1]
CHOSEN = [  # nine lines in ten of the kernels in half a minute
    "march/test_ensemble.py", "model/test_nodes.py", "references/test_sundials.py", "kernels/test_exact_motion.py",
    "references/test_frozen_motions.py::test_the_exact_motion_between_rigid_stops_is_the_frozen_one",
]  # fmt: skip


@pytest.mark.parametrize(
    "wrong",
    [np.zeros((3, 2), np.float32), np.zeros((2, 3)), np.zeros((2, 3)).T, np.zeros((6, 2))[::2], [[0.0, 0.0]] * 3, None],
    ids=["float32", "shape", "columns", "every second", "list", "None"],
)
def test_a_wrong_array_is_an_error_and_no_crash(wrong):
    with pytest.raises(TypeError, match=r"takes a float64 array of shape \(3, 2\), row by row, not "):
        address(wrong, (3, 2))


def test_a_kernel_refuses_arrays_that_do_not_fit_each_other():
    law = np.array([sb.Stops(upper=0.0, stiffness=1.0).law])
    with pytest.raises(TypeError):
        contact_forces(np.zeros(2), np.zeros(1), law)
    with pytest.raises(TypeError):
        states(*(np.zeros((1, 1)),) * 3, np.zeros((2, 1)), 1, np.zeros(4))


def test_a_library_has_the_name_of_its_sources(tmp_path, monkeypatch):
    for file in compilation.sources():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    name = compilation.library_path().name
    monkeypatch.setattr(compilation, "FOLDER", tmp_path)
    assert compilation.library_path() == tmp_path / name
    (tmp_path / "march.c").write_text("int nothing;")
    assert compilation.library_path().name != name


def test_an_installed_package_has_no_sources_but_headers(tmp_path, monkeypatch):
    monkeypatch.setattr(compilation, "FOLDER", tmp_path)
    for name in ("kernels-0123456789ab.so", "law.h"):
        (tmp_path / name).touch()
    assert compilation.library_path() == tmp_path / "kernels-0123456789ab.so"


def test_what_is_missing_is_said_in_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(compilation.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"need a C compiler: install gcc or clang, or `pip install ziglang`\.$"):
        compilation.build(tmp_path / "kernels.so")
    monkeypatch.undo()
    monkeypatch.setenv("CC", "false")
    with pytest.raises(ImportError, match="do not compile with false"):
        compilation.build(tmp_path / "kernels.so")


@pytest.mark.slow
def test_kernels_for_any_processor_keep_within_their_memory(tmp_path):
    """Without the loops for the vector registers of today's processors, with the compiler's checks of addresses and of
    undefined behaviour where it has them."""
    checks, checked = ["-fsanitize=address,undefined", "-fno-sanitize-recover=undefined", "-g", "-O1"], dict[str, str]()
    command = compilation.compiler()
    if sys.platform == "linux" and command is not None:
        found = subprocess.run([*command, "-print-file-name=libasan.so"], capture_output=True, text=True, check=False)
        if os.path.isabs(found.stdout.strip()):
            checked = {"LD_PRELOAD": found.stdout.strip(), "ASAN_OPTIONS": "detect_leaks=0"}  # Python itself leaks
    library = compilation.build(tmp_path / "plain.so", ["-DHOT=", *(checks if checked else ())])
    environment = {**os.environ, "STIFFBEAM_KERNELS": str(library), **checked}
    options = ["-q", "-n", "0", "-p", "no:cacheprovider", *(str(TESTS / x) for x in CHOSEN)]
    command = [sys.executable, "-m", "pytest", *options]
    done = subprocess.run(command, env=environment, cwd=TESTS.parent, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
