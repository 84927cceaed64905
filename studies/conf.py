"""Sphinx settings of the pages in this folder: ``sphinx-build -W studies OUT``."""

project = author = html_title = "stiffbeam"
extensions = ["myst_nb", "sphinx.ext.autodoc", "numpydoc", "sphinx_copybutton"]
master_doc = "index"
include_patterns = ["*.md", "*.ipynb", "guide/*.md", "theory/*.md"]
html_theme = "pydata_sphinx_theme"
html_theme_options = {"navigation_with_keys": False, "show_prev_next": False, "header_links_before_dropdown": 6}
html_show_sourcelink = False
myst_heading_anchors = 4
nb_execution_mode = "off"  # a test runs the notebook and compares what it prints
numpydoc_show_class_members = False
suppress_warnings = ["myst.xref_missing"]  # links to files of the repository that are no pages


def setup(app):
    """The bar of an absolute value is no substitution: docstrings are written for readers of code."""

    def bars(app, what, name, value, options, lines):
        lines[:] = [line.replace("|", "\N{DIVIDES}") for line in lines]

    app.connect("autodoc-process-docstring", bars)
