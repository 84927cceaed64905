"""Settings of the site. In the repository: ``sphinx-build -W -c studies . stiffbeam-output/site``."""

from __future__ import annotations

import os

os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"  # cells show their pictures, whoever builds
project = author = html_title = "stiffbeam"
extensions = ["myst_nb", "sphinx.ext.autodoc", "numpydoc", "sphinx_copybutton"]
root_doc = "studies/README"
include_patterns = [
    "README.md", "CONTRIBUTING.md", "CHANGELOG.md", "studies/*.md", "studies/*/*.md", "studies/tutorial/*.ipynb",
    "reference/**.md", "tests/campaigns/*.md",
]  # fmt: skip
exclude_patterns = ["reference/problems/*/**"]
myst_heading_anchors = 4
nb_execution_mode = "force"
nb_execution_excludepatterns = ["*.ipynb"]  # the notebook holds its outputs, which a test compares
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_output_stderr = "remove"  # progress, on a slow machine
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
numpydoc_show_class_members = False
python_display_short_literal_types = True
html_theme = "pydata_sphinx_theme"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_theme_options = {
    "navigation_with_keys": False, "show_prev_next": False, "header_links_before_dropdown": 6, "icon_links": [],
}  # fmt: skip
html_show_sourcelink = False
html_context = {"default_mode": "auto"}


def keep_formulas(app: object, what: str, name: str, value: object, options: object, lines: list[str]) -> None:
    """Show indented blocks of a docstring as they stand, and absolute values in sentences as bars.

    An indented block after an empty line is a formula; after a line of text it describes the parameter on that line.
    """
    shown: list[str] = []
    block = "text"
    for before, line in zip(["", *lines], lines, strict=False):
        if line.strip() and not line.startswith("    "):
            block = "text"
        elif line.strip() and block == "text":
            block = "description" if before.strip() else "formula"
            shown += ["::", ""] if block == "formula" and shown else []
        code = line.split("``")
        code[::2] = [text if block == "formula" else text.replace("|", r"\|") for text in code[::2]]
        shown.append("``".join(code))
    lines[:] = shown


def setup(app: object) -> None:
    """Register the hook for docstrings."""
    app.connect("autodoc-process-docstring", keep_formulas, priority=0)  # type: ignore[attr-defined]
