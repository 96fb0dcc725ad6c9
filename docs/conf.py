"""Configuration of the documentation: `python -m sphinx -W --keep-going docs site`."""

import re
import tomllib
from importlib.resources import files
from pathlib import Path
from posixpath import dirname

from docutils.nodes import SkipNode
from latex2mathml.converter import convert
from sphinx.ext.napoleon import Config, NumpyDocstring

PACKAGE = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text("utf-8"))

project = "flexarm"
version = release = PACKAGE["project"]["version"]
author = copyright = "flexarm contributors"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx_copybutton"]
root_doc = "index"
html_title = "flexarm"
html_theme = "furo"
html_static_path = ["_static", str(files("ziamath") / "fonts" / "STIXTwoMath-Regular.ttf")]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_copy_source = html_show_sphinx = html_show_copyright = False

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
myst_fence_as_directive = ["math"]
default_role = "code"
autodoc_default_options = {"members": True}
autodoc_member_order = "bysource"
python_use_unqualified_type_names = True
maximum_signature_line_length = 80
suppress_warnings = ["ref.python"]  # the n of a shape (n,) is no reference

FOLDERS = ("envs/README", "results/README")  # their contents are the other pages beside them
ALIKE = {"aligned": "split", "gathered": "matrix"}  # environments that latex2mathml knows


def setup(app):
    """Connect what Sphinx has no option for."""
    app.add_html_math_renderer("mathml", (inline_formula, None), (block_formula, None))
    app.connect("source-read", add_contents)
    app.connect("autodoc-process-docstring", read_docstring)
    app.connect("autodoc-process-signature", tidy_signature)


def inline_formula(writer, node):
    """Write a formula inside a line as MathML, which a browser draws without scripts."""
    writer.body.append(mathml(node.astext(), "inline"))
    raise SkipNode


def block_formula(writer, node):
    """Write a formula on lines of its own, its number at the right."""
    formula, _, number = node.astext().partition(r"\tag")
    shown = f'<span class="number">({number.strip(" {}")})</span>' if number else ""
    writer.body.append(f'<div class="formula">{mathml(formula, "block")}{shown}</div>')
    raise SkipNode


def mathml(latex, display):
    """MathML of a formula, after writing differently what latex2mathml does not know."""
    for name, alike in ALIKE.items():
        latex = latex.replace(f"{{{name}}}", f"{{{alike}}}")
    latex = re.sub(r"\\mathrel\{(.)\}=", r"\\;\\operatorname{\1=}\\;", latex)
    latex = re.sub(
        r"(_\{.*?\}|_\w)('+)", lambda m: m[1] + "^{" + r"\prime" * len(m[2]) + "}", latex
    )
    return convert(latex, display=display)


def add_contents(app, name, source):
    """Add a hidden list of contents to the first page of a folder."""
    if name in FOLDERS:
        pages = sorted(page for page in app.env.found_docs if dirname(page) == dirname(name))
        lines = "\n".join(f"/{page}" for page in pages if page != name)
        source[0] += f"\n```{{toctree}}\n:hidden:\n\n{lines}\n```\n"


def read_docstring(app, what, name, obj, options, lines):
    """Read the sections of a docstring; a property's colon is no type."""
    if what != "property":
        settings = Config(napoleon_use_param=False, napoleon_use_rtype=False)
        lines[:] = NumpyDocstring(list(lines), settings, what=what, name=name, obj=obj).lines()


def tidy_signature(app, what, name, obj, options, signature, returns):
    """Write default factories as dots, so that a signature is Python, and arrays without shape."""
    array = re.compile(r"ndarray\[tuple\[~?\w*\.?Any, \.\.\.\], ~?[\w.]+\[.*?\]\]")
    tidy = (
        text and array.sub("ndarray", text.replace("<factory>", "..."))
        for text in (signature, returns)
    )
    return tuple(tidy)
