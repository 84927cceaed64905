"""The site: guide, theory, how-to scripts, gallery of all studies and the reference of the Python names.

    python studies/site.py --out FOLDER              # with every study on Table 10 and every script: minutes
    python studies/site.py --out FOLDER --run amplification,steel_strip --smoke

One source a text: the pages are the Markdown files and scripts of this repository, at the same paths with .html.
Warnings are errors, and so is a link, a picture or an anchor that leads nowhere.
"""

from __future__ import annotations

import argparse
import ast
import html
import io
import json
import os
import re
import shutil
import subprocess
import sys
import warnings
from collections.abc import Iterable, Sequence
from contextlib import redirect_stdout
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).parent.parent
CHAPTERS = {
    "Start": ["README.md", "studies/first_beam.ipynb"],
    "Guide": [
        "studies/guide/beam.md", "studies/guide/choose.md", "studies/guide/convergence.md", "studies/guide/runs.md",
        "studies/guide/stops.md", "studies/guide/model.md", "studies/guide/ensembles.md",
        "studies/guide/references.md", "studies/guide/commands.md", "studies/guide/records.md",
        "studies/guide/words.md", "studies/guide/weight.md", "studies/guide/other_tools.md",
        "studies/guide/citing.md",
    ],
    "How to": ["studies/steel_strip.py", "studies/hermite_model.py", "studies/hammer.py", "studies/base_motion.py"],
    "Theory": ["studies/theory/horizon.md", "studies/theory/march.md", "studies/theory/exact.md"],
    "Answers": [
        "studies/README.md", "gallery", "reference/problems/README.md", "studies/other_engines.md",
        "reference/README.md",
    ],
    "Reference": ["api/stiffbeam.html", "CONTRIBUTING.md", "tests/campaigns/README.md", "CHANGELOG.md"],
}  # fmt: skip
SCRIPTS = [Path(source).stem for source in CHAPTERS["How to"]]
WHERE = {"MPLBACKEND": "agg", "COLUMNS": "80"}
SWEEP = {"parameter": "frequency", "values": [8.0 + 0.2 * k for k in range(31)]}


def target_of(source: str) -> str:
    """Where the page of a file lies in the site."""
    if source in ("README.md", "gallery"):
        return {"README.md": "index.html", "gallery": "gallery.html"}[source]
    return re.sub(r"README\.md$", "index.html", re.sub(r"(?<!README)\.(md|py|ipynb)$", ".html", source))


def markdown(text: str) -> str:
    """Markdown as GitHub reads it: tables, fenced code, anchors at headings."""
    import markdown2

    extras = {"tables": None, "fenced-code-blocks": None, "header-ids": None, "code-friendly": None}
    page = str(markdown2.markdown(text, extras=extras))
    page = re.sub(r"<pre>(?!<span|<code)", "<pre><code>", page)
    page = re.sub(r"(?<![\w.])(\d[\d.]*e-\d+)(?![^<]*>)", r'<span class="number">\1</span>', page)
    return re.sub(r"<pre([ >])", r'<pre tabindex="0"\1', page).replace(" />", ">")


def script(path: Path, folder: Path, run: bool) -> str:
    """A how-to script as a page: its docstring is the text, then what it draws into ``folder`` and prints if it is
    ``run``, then itself."""
    text = path.read_text(encoding="utf-8")
    words = re.match(r'"""(.*?)"""', text, re.DOTALL)
    if words is None:
        raise ValueError(f"{path} says nothing of itself")
    title, _, rest = words[1].partition("\n")
    parts = [f"# {title.strip().rstrip('.')}\n{rest}"]
    if run:
        folder.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-W", "error", str(path), "--out", str(folder)]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=os.environ | WHERE)
        parts += [f"[![What it draws]({address})]({address})" for address in drawn(folder)]
        parts += [f"It prints:\n\n```text\n{done.stdout.rstrip()}\n```", "All of it:"]
    return markdown("\n\n".join([*parts, f"```python\n{text[words.end() :].strip()}\n```\n"]))


def drawn(folder: Path) -> list[str]:
    """The pictures in a folder beside a page, as the page calls them."""
    return [f"{folder.name}/{picture.name}" for picture in sorted(folder.glob("*.png"))]


def notebook(path: Path, folder: Path) -> str:
    """A notebook as a page: texts, code, what it printed, and into ``folder`` what it draws."""
    folder.mkdir(parents=True, exist_ok=True)
    parts, names = [], {}
    for number, cell in enumerate(json.loads(path.read_text(encoding="utf-8"))["cells"]):
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```python\n{source}\n```")
        lines = ast.parse(source)
        last = lines.body.pop() if isinstance(lines.body[-1], ast.Expr) else ast.Expr(ast.Constant(None))
        with redirect_stdout(io.StringIO()) as said:
            exec(compile(lines, path, "exec"), names)
            found = eval(compile(ast.Expression(ast.fix_missing_locations(last).value), path, "eval"), names)
        if said.getvalue():
            parts.append(f"```text\n{said.getvalue().rstrip()}\n```")
        if hasattr(found, "savefig"):
            found.savefig(folder / f"{number}.png", dpi=100)
            parts.append(f"[![What it draws]({folder.name}/{number}.png)]({folder.name}/{number}.png)")
    return markdown("\n\n".join(parts))


def gallery(names: Iterable[str], out: Path, smoke: bool) -> str:
    """Every study on Table 10: question, command, picture, answer."""
    from stiffbeam.files.cases import find_case
    from stiffbeam.studies import STUDIES, find_study
    from stiffbeam.studies.engine.runner import run_study

    parts = ["# All studies on Table 10", "Each is one command; its records lie beside the picture as JSON and CSV."]
    case, known = find_case("table10"), set(STUDIES)
    for name in names:
        if name not in known:
            raise ValueError(f"no study is called {name!r}")
        study = find_study(name)
        options = (dict(study.smoke) if smoke else {}) | (SWEEP if name == "sweep" else {})
        records = run_study(study, case, out / "gallery" / "journal", **options)
        records.save(out / "gallery", name)
        command = f"stiffbeam {name.replace('_', '-')}"
        parts += [
            f"## {name.replace('_', ' ')}",
            study.question,
            f"    {command}",
            f"[![{study.question}](gallery/{name}.png)](gallery/{name}.png)",  # on a phone it is small
        ]
        parts.append(records.answer.verdict)
        if table := records.answer.table:
            heads = list(dict.fromkeys(key for line in table for key in line))
            rows = [[line.get(head, "–") for head in heads] for line in table]
            parts.append("\n".join(f"| {' | '.join(row)} |" for row in [heads, ["---"] * len(heads), *rows]))
        parts.append(records.answer.notes)
        parts.append(f"[JSON](gallery/{name}.json) · [CSV](gallery/{name}.csv)")
    return markdown("\n\n".join(parts))


def title_of(body: str) -> str:
    found = re.search(r"<h1[^>]*>(.*?)</h1>", body, re.DOTALL)
    return re.sub(r"<[^>]+>", "", found[1]).strip() if found else "stiffbeam"


def shortened(title: str) -> str:
    """A title for the list of pages: that of a script ends at its first comma."""
    short = title.removeprefix("How to: ").split(",")[0].rstrip(".") if title.startswith("How to: ") else title
    return short[:1].upper() + short[1:] if short != "stiffbeam" else short


def relinked(body: str, source: str, out: Path, pages: dict[str, str]) -> str:
    """Links to files of the repository lead to their pages; what is no page is copied beside them."""
    here = Path(target_of(source)).parent

    def link(found: re.Match[str]) -> str:
        name, address = found[1], html.unescape(found[2])
        parts = urlsplit(address)
        if parts.scheme or not parts.path or source == "gallery" or (out / here / parts.path).is_file():
            return found[0]
        inside = os.path.normpath(Path(source).parent / unquote(parts.path))
        inside = "README.md" if inside == "." else inside
        if (ROOT / inside).is_dir():
            inside = f"{inside}/README.md"
        if not (ROOT / inside).is_file():
            raise ValueError(f"{source}: {address} leads nowhere")
        there = pages.get(inside)
        if there is None:
            there = inside
            (out / there).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / inside, out / there)
        end = f"#{parts.fragment}" if parts.fragment else ""
        return f'{name}="{html.escape(os.path.relpath(there, here))}{end}"'

    return re.sub(r'\b(href|src)="([^"]*)"', link, body)


def page(body: str, source: str, titles: dict[str, str]) -> str:
    """The whole page, with the way to all others."""
    from jinja2 import Environment, FileSystemLoader

    here = Path(target_of(source)).parent
    environment = Environment(loader=FileSystemLoader(Path(__file__).parent), trim_blocks=True, lstrip_blocks=True)
    return environment.get_template("site.html").render(
        body=body, source=source, title=title_of(body), titles=titles, chapters=CHAPTERS,
        way=lambda target: os.path.relpath(target, here), target_of=target_of,
    ).lstrip()  # fmt: skip


class _Links(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id" and value:
                self.ids.add(value)
            elif name in ("href", "src") and value:
                self.links.append(value)


def broken(out: Path) -> list[str]:
    """Every link of the site that leads nowhere."""
    read = {path: _Links(path.read_text(encoding="utf-8")) for path in out.rglob("*.html")}
    found = []
    for path, own in read.items():
        for address in own.links:
            parts = urlsplit(address)
            if parts.scheme or address.startswith("//"):
                continue
            there = Path(os.path.normpath(path.parent / unquote(parts.path))) if parts.path else path
            known = read.get(there)
            if not there.is_file() or (parts.fragment and known and unquote(parts.fragment) not in known.ids):
                found.append(f"{path.relative_to(out)}: {address}")
    return found


def build(out: Path, run: Sequence[str], smoke: bool) -> None:
    """Write the site into ``out``, with the results of these studies and scripts."""
    import pdoc
    import pdoc.render

    out.mkdir(parents=True, exist_ok=True)
    sources = [source for chapter in CHAPTERS.values() for source in chapter if not source.startswith("api/")]
    pages = {source: target_of(source) for source in sources}
    bodies: dict[str, str] = {}
    for source in sources:
        path = ROOT / source
        if source == "gallery":
            bodies[source] = gallery([name for name in run if name not in SCRIPTS], out, smoke)
        elif path.suffix == ".py":
            bodies[source] = script(path, (out / source).with_suffix(""), path.stem in run)
        elif path.suffix == ".ipynb":
            bodies[source] = notebook(path, (out / source).with_suffix(""))
        else:
            bodies[source] = markdown(path.read_text(encoding="utf-8"))
    titles = {source: shortened(title_of(body)) for source, body in bodies.items()}
    titles |= {"README.md": "stiffbeam", "api/stiffbeam.html": "All Python names"}
    sheets = (ROOT / "studies" / name for name in ("dumont2002/style.css", "site.css"))
    (out / "style.css").write_text("\n".join(sheet.read_text(encoding="utf-8") for sheet in sheets), encoding="utf-8")
    for source, body in bodies.items():
        file = out / target_of(source)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(page(relinked(body, source, out, pages), source, titles), encoding="utf-8")
    pdoc.render.configure(docformat="markdown", show_source=False, footer_text="stiffbeam")
    pdoc.pdoc("stiffbeam", "!stiffbeam\\.", output_directory=out / "api")
    _lead_home(out / "api" / "stiffbeam.html")
    if wrong := broken(out):
        raise ValueError("links that lead nowhere:\n" + "\n".join(wrong))


def _lead_home(file: Path) -> None:
    """Pdoc's page gets a way back to the others, and no links to inherited members: pdoc lists them without anchors."""
    text, heading = file.read_text(encoding="utf-8"), "<h2>API Documentation</h2>"
    anchors = _Links(text).ids
    text = re.sub(
        r'<a href="#([^"]+)">(.*?)</a>', lambda link: link[0] if link[1] in anchors else link[2], text, flags=re.DOTALL
    )
    if text.count(heading) != 1:
        raise ValueError(f"{file.name} has no list of names to put the way home before")
    home = '<p><a href="../index.html">stiffbeam: all pages</a></p>\n'
    file.write_text(text.replace(heading, home + heading), encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("stiffbeam-output/site"))
    parser.add_argument("--run", help="studies and how-to scripts with commas between them; all by default")
    parser.add_argument("--smoke", action="store_true", help="the small configuration of each study")
    given = parser.parse_args()
    from stiffbeam.studies import STUDIES

    warnings.simplefilter("error")
    build(given.out, [*STUDIES, *SCRIPTS] if given.run is None else given.run.split(","), given.smoke)
    print(f"Written: {given.out / 'index.html'}", file=sys.stderr)


if __name__ == "__main__":
    main()
