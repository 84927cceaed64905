"""Columns of numbers as loggers, spreadsheets and other programs write them."""

from __future__ import annotations

import os

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.files import columns
from stiffbeam.files.columns import read_samples

T, F = np.arange(12) * 0.25, np.array([0.0, 3.5, -1.25, 2.0, 0.5, -7.0, 1.0, 0.25, -0.5, 4.0, 1.5, 0.0])


@pytest.fixture
def read(tmp_path):
    def samples(text, *options, encoding="utf-8", **more):
        file = tmp_path / "record.csv"
        file.write_text(text, encoding=encoding)
        return read_samples(file, *options, **more)

    return samples


def lines(form, times=T, comma=False):
    rows = (form.format(i=i, t=repr(float(t)), f=repr(float(f))) for i, (t, f) in enumerate(zip(times, F, strict=True)))
    return "\n".join(row.replace(".", ",") if comma else row for row in rows) + "\n"


WRITTEN = {
    "two columns": lines("{t},{f}"), "blanks": lines("  {t}   {f}"), "tabs": lines("{t}\t{f}"),
    "names": "t,force\n" + lines("{t},{f}"), "Excel": "\ufeffZeit [s];Kraft [N]\r\n" + lines("{t};{f}", comma=True),
    "swapped": "force,time\n" + lines("{f},{t}"), "pandas": ",t,force\n" + lines("{i},{t},{f}"),
    "pandas again": "Unnamed: 0,force,Time (s)\n" + lines("{i},{f},{t}"),
    "numpy": "# force t\n" + lines("{f} {t}"), "comments": "# a logger\n% more\n\n" + lines("{t} {f}") + "# end\n",
    "decimal commas and blanks": lines("{t} {f}", comma=True), "quotes": '"t","F"\n' + lines('"{t}","{f}"'),
    "quoted commas": '"t","F"\n' + lines('"{t}";"{f}"', comma=True),
}  # fmt: skip


@pytest.mark.parametrize("kind", WRITTEN)
def test_one_record_is_the_same_however_it_is_written(kind, read):
    for encoding in ("utf-8", "utf-8", "latin-1") if "\ufeff" not in WRITTEN[kind] else ("utf-8",):
        t, values = read(WRITTEN[kind], encoding=encoding)
        np.testing.assert_array_equal(t, T)
        np.testing.assert_array_equal(values, F)


def test_times_are_scaled_shifted_and_made(read):
    ms = "time [ms];F\n" + lines("{t};{f}", 1000.0 * T)
    np.testing.assert_allclose(read(ms, time_factor=1e-3)[0], T, rtol=1e-15)
    np.testing.assert_allclose(read(lines("{t},{f}", 1e6 + T), start=0.0)[0], T, atol=1e-9)
    np.testing.assert_array_equal(read(lines("{f}"), dt=0.25)[0], T)
    np.testing.assert_array_equal(read("a,b\n" + lines("{i},{f}"), "b", dt=0.25, start=1.0)[0], 1.0 + T)
    np.testing.assert_array_equal(read("t,gain,force\n" + lines("{t},1,{f}"), "force")[1], F)


REFUSED = [  # text, options, words
    ("time [ms];F\n" + lines("{t};{f}"), {}, "time_factor must be given for times in ms.*time_factor = 0.001"),
    (lines("{f},{t}"), {}, "have its times first"), (lines("{i},{t},{f}"), {"column": "b"}, "row numbers"),
    (lines("{f}"), {}, "give dt"), ("t,F\n" + lines("{t},{f}"), {"dt": 0.1}, "dt must be left out"),
    ("t,time\n" + lines("{t},{f}"), {}, "have one column of times"), ("", {}, "two or more lines"),
    ("t,F\n", {}, "below their names"), ("0,1\n1,\n", {}, "line 2: ''.*cell is empty"),
    ("0,1\n1,nan\n", {}, "line 2: 'nan'"), ("0,1\n1,2,3\n", {}, "line 2: 3 columns"),
    ("t,F,F\n0,1,2\n1,1,3\n", {"column": "F"}, "name of one column"),
    ("t,F,G\n0,1,2\n1,1,3\n", {"column": "H"}, "be a name in the first line.*F, G"),
    ("t,F,G\n0,1,2\n1,1,3\n", {"column": "t"}, "holds the times"),
    ("t,F,G\n0,1,2\n1,1,3\n", {}, "column = 'F' or 'G'"),
    ("Time;Force\n[s];[N]\n0;1\n1;1\n", {}, r"line 2: '\[s\]'.*all but one line of names"),
    ("t,\x1b[2J\n0,1\n1,2\n", {"column": "F"}, r"\\x1b\[2J"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "options", "words"), REFUSED, ids=[words for *_, words in REFUSED])
def test_what_may_be_misread_is_refused(text, options, words, read):
    with pytest.raises(sb.InputError, match=words) as caught:
        read(text, **options)
    assert "\x1b" not in str(caught.value)


def test_holes_are_named_but_where_nothing_acts(read):
    kept = np.delete(np.arange(12), [5, 6])
    text = "\n".join(f"{t!r},{f!r}" for t, f in zip(T[kept].tolist(), F[kept].tolist(), strict=True))
    with pytest.warns(UserWarning, match="a hole from t = 1 to 1.75"):
        read(text.replace("\n", "\n") + "\n" + "\n".join(f"{3 + 0.25 * k},{k % 2}" for k in range(20)))
    t, _ = read(text[: text.index("1.75")] + "\n".join(f"{1.25 + 0.25 * k},0" for k in range(9)) + "\n99,0\n")
    assert t[-1] == 99.0


@pytest.mark.parametrize("seed", range(40))
def test_any_damaged_record_is_one_sentence_or_numbers(seed, read):
    rng = np.random.default_rng([60, seed])
    text = list(WRITTEN[rng.choice(list(WRITTEN))])
    for place in rng.integers(0, len(text), 3):
        text[place] = rng.choice(["", ",", ";", "\t", "x", "\n", "-", '"', "\x00", "1e999"])
    try:
        t, values = read("".join(text))
        said = "numbers" if np.all(np.isfinite(t)) and len(t) == len(values) else ""
    except sb.InputError as error:
        said = str(error) if "record.csv" in str(error) or "time_factor" in str(error) else ""
    assert said
    assert "\n" not in said


def test_regular_files_of_a_largest_size_alone_are_read(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe.csv")
    for name in ("/dev/zero", tmp_path / "pipe.csv", tmp_path, tmp_path / "none.csv"):
        with pytest.raises(sb.InputError, match="be a readable file"):
            read_samples(tmp_path / name)
        with pytest.raises(sb.InputError, match="case file"):
            sb.load_cases(name)
        with pytest.raises(sb.InputError, match="exist"):
            sb.load(name)
    monkeypatch.setattr(columns, "MOST_BYTES", 20)
    (tmp_path / "long.csv").write_text(WRITTEN["names"])
    with pytest.raises(sb.InputError, match="have at most 20 bytes"):
        read_samples(tmp_path / "long.csv")
