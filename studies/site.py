"""The documentation as a site: guides, theory, how-to scripts, all studies on Table 10, and the Python names.

    python studies/site.py --out FOLDER             # every study in full: minutes the first time
    python studies/site.py --out FOLDER --smoke     # the longest studies in their smallest configuration

The pages are the Markdown files, scripts and notebooks of this repository. The build runs scripts, cells and studies,
so the site shows what they print. Sphinx makes it; a warning is an error.
"""

from __future__ import annotations

import argparse
import base64
import inspect
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).parent.parent
JOURNAL = ROOT / "stiffbeam-output" / "site-journal"  # finished points of studies: a second build reads them
LONG = ("first_impact", "rigid_bar", "impacts", "precision", "orbits")  # each takes as long as all the others
SWEEP = {"parameter": "frequency", "values": [8.0 + 0.2 * k for k in range(31)]}
CHAPTERS = {
    "Tutorials": [
        "studies/first_beam.ipynb", "studies/guide/convergence.md", "studies/guide/solver.md",
        "studies/guide/references.md",
    ],
    "How to": [
        "studies/guide/choose.md", "studies/guide/schemes.md", "studies/guide/beam.md", "studies/guide/stops.md",
        "studies/guide/model.md", "studies/guide/runs.md", "studies/guide/ensembles.md",
        "studies/guide/derivatives.md", "studies/guide/orbits.md", "studies/guide/other_tools.md",
        "studies/steel_strip.py", "studies/hermite_model.py", "studies/hammer.py", "studies/base_motion.py",
        "studies/loose_supports.py", "studies/identify.py",
    ],
    "Answers": [
        "studies/gallery.md", "studies/README.md",
        "reference/problems/README.md", "reference/orbits/README.md",
        "studies/engines/README.md", "reference/README.md", "reference/agreement.md",
    ],
    "Theory": ["studies/theory/horizon.md", "studies/theory/march.md", "studies/theory/exact.md"],
    "Reference": [
        "studies/guide/commands.md", "studies/names/data.md",
        "studies/names/model.md", "studies/names/schemes.md", "studies/names/runs.md",
        "studies/names/measures.md", "studies/names/testset.md", "studies/guide/records.md", "studies/guide/words.md",
        "studies/guide/citing.md", "CONTRIBUTING.md", "tests/campaigns/README.md",
        "CHANGELOG.md",
    ],
}  # fmt: skip
TOPICS = {  # pages of Python names: title, and the rooms of the package whose public names they hold
    "model": ("Model", ("basics", "model")),
    "schemes": ("Schemes", ("schemes",)),
    "runs": ("Runs and references", ("trajectory", "piecewise", "march", "references", "files")),
    "measures": ("Measures, pictures and studies", ("measures", "figures", "studies")),
    "testset": ("Test set", ("testset",)),
}
PICTURE = re.compile(r"^!\[([^]]*)\]\(([^)]*)\)$", re.MULTILINE)  # on a line of its own: words, address
LINK = re.compile(r"(\]\()([^)#\s:]+)((?:#[^)\s]*)?\))")  # of Markdown, inside the repository: address, anchor
SETTINGS = {
    "project": "stiffbeam",
    "author": "stiffbeam",
    "extensions": ["myst_parser", "sphinx.ext.autodoc", "numpydoc", "sphinx_copybutton"],
    "html_theme": "pydata_sphinx_theme",
    "html_theme_options": {
        "navigation_with_keys": False,
        "show_prev_next": False,
        "header_links_before_dropdown": 6,
        "icon_links": [],
    },
    "html_title": "stiffbeam",
    "html_show_sourcelink": False,
    "html_context": {"default_mode": "auto"},
    "html_static_path": ["_static"],
    "html_css_files": ["wide.css"],
    "myst_heading_anchors": 4,
    "autodoc_typehints": "signature",
    "autodoc_member_order": "bysource",
    "numpydoc_show_class_members": False,
    "python_display_short_literal_types": True,
}


WIDE = """.bd-main .bd-content .bd-article-container {max-width: 80em}
@media (min-width: 60em) {.bd-sidebar-primary {flex: 0 0 16rem}}
"""  # more of a line of code fits


class Pages:
    """The sources of the site in a folder: pages as Markdown, what they draw, and the files that they link to."""

    def __init__(self, folder: Path, smoke: bool) -> None:
        self.folder, self.smoke = folder, smoke
        self.sources = {_page(source): PurePosixPath(source) for chapter in CHAPTERS.values() for source in chapter}

    def write(self) -> None:
        """Write every page, and the first one, which leads to all of them."""
        self.save("_static/wide.css", WIDE.encode())
        texts = {page: self.text(page, source) for page, source in self.sources.items()}
        for page, text in texts.items():
            self.save(page, text.encode())
        for title, sources in CHAPTERS.items():
            pages = [_page(source) for source in sources]
            parts = [f"# {title}", *(entry(page, texts[page]) for page in pages), _contents(pages, ":hidden:")]
            self.save(f"{_slug(title)}.md", "\n\n".join(parts).encode())
        home = self.linked((ROOT / "README.md").read_text(encoding="utf-8"), PurePosixPath("README.md"))
        self.save("index.md", f"{home}\n\n{_contents(map(_slug, CHAPTERS), ':hidden:')}".encode())

    def save(self, address: str, content: bytes) -> None:
        (self.folder / address).parent.mkdir(parents=True, exist_ok=True)
        (self.folder / address).write_bytes(content)

    def text(self, page: str, source: PurePosixPath) -> str:
        """Return the Markdown of a page."""
        path = ROOT / source
        if source.stem == "gallery":
            return self.gallery(page)
        if source.parts[-2:] == ("names", "data.md"):
            return variables()
        if source.parent.name == "names":
            return names(source.stem)
        if source.suffix == ".py":
            return self.script(path, page)
        if source.suffix == ".ipynb":
            return self.notebook(path, page)
        return self.linked(path.read_text(encoding="utf-8"), source)

    def linked(self, text: str, source: PurePosixPath) -> str:
        """Return a text whose links lead to pages; what is no page but a file of the repository is copied."""

        def link(written: re.Match[str]) -> str:
            inside = os.path.normpath(source.parent / written[2])
            if (ROOT / inside).is_dir():
                inside = os.path.normpath(f"{inside}/README.md")
            there = {"README.md": "index.md"}.get(inside, _page(inside))
            if there not in self.sources and there != "index.md":
                there = inside
                if (ROOT / inside).is_file():
                    self.save(inside, (ROOT / inside).read_bytes())
            return f"{written[1]}{os.path.relpath(there, source.parent)}{written[3]}"

        return LINK.sub(link, text)

    def picture(self, page: str, name: str, content: bytes, words: str) -> str:
        """Keep a picture of a page; return the Markdown that shows it."""
        folder = PurePosixPath(page).with_suffix("")
        self.save(str(folder / name), content)
        return f"![{words}]({folder.name}/{name})"

    def script(self, path: Path, page: str) -> str:
        """Return a how-to script as a page: its docstring, what it draws and prints, and the script itself."""
        text = path.read_text(encoding="utf-8")
        words = re.match(r'"""(.*?)"""', text, re.DOTALL)
        if words is None:
            raise ValueError(f"{path} has no docstring")
        title, _, rest = words[1].partition("\n")
        drawn = (self.folder / page).with_suffix("")
        drawn.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-W", "error", str(path), "--out", str(drawn)]
        environment = os.environ | {"MPLBACKEND": "agg", "COLUMNS": "80"}
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=environment)
        shown = [
            self.picture(page, file.name, file.read_bytes(), f"Picture of {path.name}")
            for file in sorted(drawn.glob("*.png"))
        ]
        printed = f"Output:\n\n```text\n{done.stdout.rstrip()}\n```"
        code = f"The script:\n\n```python\n{text[words.end() :].strip()}\n```"
        return "\n\n".join([f"# {title.strip().rstrip('.')}\n{rest}", *shown, printed, code])

    def notebook(self, path: Path, page: str) -> str:
        """Return a notebook as a page, every cell run in a kernel now."""
        import nbformat
        from nbclient import NotebookClient

        book = nbformat.read(path, as_version=4)
        NotebookClient(book, kernel_name="python3", resources={"metadata": {"path": str(path.parent)}}).execute()
        parts: list[str] = []
        for number, cell in enumerate(book.cells):
            if cell.cell_type == "markdown":
                parts.append(cell.source)
                continue
            parts.append(f"```python\n{cell.source}\n```")
            for output in cell.outputs:
                data = output.get("data", {})
                if "image/png" in data:
                    content = base64.b64decode(data["image/png"])
                    parts.append(self.picture(page, f"{number}.png", content, f"Picture of cell {number}"))
                elif shown := output.get("text") or data.get("text/plain"):
                    parts.append(f"```text\n{shown.rstrip()}\n```")
        return "\n\n".join(parts)

    def gallery(self, page: str) -> str:
        """Return every study on Table 10: question, command, verdict, picture, table."""
        from stiffbeam.files.cases import find_case
        from stiffbeam.studies import STUDIES, find_study
        from stiffbeam.studies.runner import run_study

        parts = [
            "# All studies on Table 10",
            "Each study is one command. `python studies/site.py` runs them all and writes this page and the pictures.",
        ]
        case = find_case("table10")
        folder = (self.folder / page).with_suffix("")
        for name in STUDIES:
            study = find_study(name)
            options = (dict(study.smoke) if self.smoke and name in LONG else {}) | (SWEEP if name == "sweep" else {})
            records = run_study(study, case, JOURNAL, **options)
            records.save(folder, name)
            picture = self.picture(page, f"{name}.png", (folder / f"{name}.png").read_bytes(), study.question)
            parts += [f"## {name.replace('_', ' ')}", study.question, f"`stiffbeam {name.replace('_', '-')} table10`"]
            parts += [records.answer.verdict, picture]
            if table := records.answer.table:
                heads = list(dict.fromkeys(key for line in table for key in line))
                rows = [[line.get(head, "–").replace("|", r"\|") for head in heads] for line in table]
                parts.append("\n".join(f"| {' | '.join(row)} |" for row in [heads, ["---"] * len(heads), *rows]))
            files = " · ".join(f"{{download}}`{end.upper()} <gallery/{name}.{end}>`" for end in ("json", "csv"))
            parts += [records.answer.notes, files]
        return "\n\n".join(filter(None, parts))


def entry(page: str, text: str) -> str:
    """Return what the page of a chapter shows of a page: its title, first sentence and first picture."""
    title, *parts = re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE).strip().split("\n\n")
    words = next((part for part in (each.strip("\n") for each in parts) if re.match(r"[A-Za-z`[]", part)), "")
    sentence = LINK.sub("]", re.split(r"(?<=[.?:])\s", words.replace("\n", " "))[0]).replace("[", "").replace("]", "")
    shown = [f"## [{title.removeprefix('# ')}](/{page})", sentence.rstrip(":")]
    if picture := PICTURE.search(text):
        address = os.path.normpath(PurePosixPath(page).parent / picture[2])
        shown.append(f"```{{image}} /{address}\n:width: 480px\n:alt: {picture[1]}\n```")
    return "\n\n".join(filter(None, shown))


def names(topic: str) -> str:
    """Return a page of Python names: all public ones of its rooms."""
    import stiffbeam as sb

    title, rooms = TOPICS[topic]
    placed = {room for _, each in TOPICS.values() for room in each}
    parts = [f"# {title}"]
    for name in sb.__all__:
        value = getattr(sb, name)
        room = value.__module__.split(".")[1]
        if room not in placed:
            raise ValueError(f"no page holds the room of stiffbeam.{name}: {room}")
        if room in rooms:
            kind = "autoclass" if inspect.isclass(value) else "autofunction"
            members = "\n   :members:" if kind == "autoclass" and not issubclass(value, Exception) else ""
            parts.append(f"## {name}\n\n```{{eval-rst}}\n.. {kind}:: stiffbeam.{name}{members}\n```")
    return "\n\n".join(parts)


def variables() -> str:
    """Return the page of variables: the schema, from which every table and file is made, as a table."""
    from stiffbeam.basics.units import SI
    from stiffbeam.trajectory.schema import CONVENTIONS, COORDINATES, FORMAT, SCHEMA

    heads = ["name", "attribute", "dimensions", "unit", "meaning"]
    parts = [
        "# Variables of tables and files",
        "A result has the same names, units and values as attributes, DataFrame, Dataset, netCDF, CSV, .mat and JSON. "
        'For example `run["energy_loss"]`, `run.to_xarray()["energy_loss"]` and the column `energy_loss` of a CSV file '
        "are `run.energy.loss`. A table in which contacts are no dimension has a column for each, `contact_force_0`, "
        "`contact_force_1`. An ensemble has the dimension `member` too, and the varied parameter by its name. "
        f"Units are those of a beam in metres, seconds and newtons; files are of format {FORMAT}, {CONVENTIONS}.",
    ]
    for title, table in (("Variables", SCHEMA), ("Coordinates", COORDINATES)):
        lines = [heads, ["---"] * len(heads)]
        for each in table:
            unit = SI.of(each.quantity) if each.quantity else "1"
            words = each.long_name.replace("|", r"\|")
            attribute = f"`{each.attribute}`" if each.attribute else "–"
            lines.append([f"`{each.name}`", attribute, ", ".join(each.dims) or "–", unit, words])
        parts += [f"## {title}", "\n".join(f"| {' | '.join(line)} |" for line in lines)]
    return "\n\n".join(parts)


def as_written(app: object, what: str, name: str, value: object, options: object, lines: list[str]) -> None:
    """Let the formulas of a docstring stand as they are: indented blocks, and bars of absolute values in sentences.

    An indented block after an empty line is a formula; after a line of text it describes the parameter on that line.
    """
    bare: list[str] = []
    block = "text"
    for before, line in zip(["", *lines], lines, strict=False):
        if line.strip() and not line.startswith("    "):
            block = "text"
        elif line.strip() and block == "text":
            block = "description" if before.strip() else "formula"
            bare += ["::", ""] if block == "formula" and bare else []
        code = line.split("``")
        code[::2] = [text if block == "formula" else text.replace("|", r"\|") for text in code[::2]]
        bare.append("``".join(code))
    lines[:] = bare


def _contents(pages: Iterable[str], *options: str) -> str:
    """Return the list of pages that stand below another one."""
    return "\n".join(["```{toctree}", ":maxdepth: 1", *options, "", *(f"/{page}" for page in pages), "```"])


def _slug(title: str) -> str:
    """Return the page of a chapter."""
    return title.lower().replace(" ", "-")


def _page(source: str) -> str:
    """Return the page of a file: Markdown of the same name."""
    path = PurePosixPath(source)
    return str(path.with_suffix(".md")) if path.suffix in (".py", ".ipynb") else source


def build(out: Path, smoke: bool) -> None:
    """Write the site into ``out``. Raises SystemExit where Sphinx warns."""
    from sphinx.application import Sphinx

    sources = out.with_name(f"{out.name}-sources")
    shutil.rmtree(sources, ignore_errors=True)
    Pages(sources, smoke).write()
    app = Sphinx(
        sources, None, out, sources / ".doctrees", "html", confoverrides=SETTINGS, warningiserror=True, status=None
    )
    app.connect("autodoc-process-docstring", as_written, priority=0)
    app.build()
    if app.statuscode:
        raise SystemExit(app.statuscode)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "stiffbeam-output" / "site")
    parser.add_argument("--smoke", action="store_true", help="the longest studies in their smallest configuration")
    arguments = parser.parse_args()
    build(arguments.out.resolve(), arguments.smoke)
    print(f"Written: {arguments.out / 'index.html'}", file=sys.stderr)


if __name__ == "__main__":
    main()
