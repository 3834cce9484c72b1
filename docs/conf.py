"""Settings of the docs site: Sphinx, on the repository's own pages and the docstrings; `build_site.py` builds it.

The source is the repository itself, so that a link between pages is the same on a forge, on disk and in the site.
"""

from __future__ import annotations

import ast
import importlib
import re
import sys
from pathlib import Path
from types import FunctionType

from sphinx.pycode import ModuleAnalyzer

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "docs"), str(ROOT / "src")]
REPOSITORY = "https://github.com/dynident/dynident/blob/main"

project = "dynident"
version = release = importlib.import_module("dynident.version").__version__
author = copyright = "the authors of dynident"
root_doc = "README"
include_patterns = [
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
    "docs/**.md",
    "docs/**.rst",
    "benchmarks/README.md",
]
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "mathml"]

# Pages.
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 6
# Languages that no highlighter knows, and JSON with dots in it, are shown as they are.
suppress_warnings = ["misc.highlighting_failure"]

# Docstrings.
default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
autodoc_default_options = {"members": True, "imported-members": True, "undoc-members": True, "show-inheritance": True}
# Attributes become fields of the class: their own entries come from the class's members.
napoleon_use_ivar = True
napoleon_google_docstring = False
napoleon_use_rtype = False
python_use_unqualified_type_names = True
add_module_names = False

# Appearance: all that a page loads is in the site.
html_theme = "furo"
html_title = f"dynident {version}"
html_math_renderer = "mathml"
html_copy_source = False
html_show_sphinx = False
html_theme_options = {"top_of_page_buttons": []}
# Summaries would be fetched, which a page on disk may not.
html_show_search_summary = False

CONTENTS = {
    "Begin": [
        *(f"docs/{page}" for page in ("installation", "tutorial", "notebook", "workbench", "agents", "my-robot")),
        *("docs/file-formats", "docs/concepts"),
    ],
    "How to": sorted(f"docs/how-to/{page.stem}" for page in (ROOT / "docs" / "how-to").glob("*.md")),
    "In depth": [
        *(f"docs/{page}" for page in ("methods", "experiments", "campaigns", "surroundings", "drive-chain")),
        *(f"docs/{page}" for page in ("closed-loops", "diagnosis", "effects", "exports", "http-service")),
        "benchmarks/README",
    ],
    "Reference": ["docs/reference/index", "docs/glossary"],
    "Contribute": [
        *(f"docs/{page}" for page in ("own-effects", "own-methods", "architecture")),
        "CONTRIBUTING",
        "SECURITY",
        "CHANGELOG",
    ],
}
"""The navigation: parts, and the pages of each."""


def contents() -> str:
    """The table of contents in the site's own words; a forge that shows the README does not need it."""
    parts = []
    for part, pages in CONTENTS.items():
        parts.append("\n".join(["```{toctree}", ":hidden:", f":caption: {part}", "", *pages, "```"]))
    return "\n\n".join(parts)


def add_contents(_app, name: str, source: list[str]) -> None:
    """The navigation, and links that the repository alone can answer."""
    if name == root_doc:
        source[0] += "\n" + contents() + "\n"
    source[0] = re.sub(r"\]\((?:\.\./)*(LICENSE|NOTICE)\)", rf"]({REPOSITORY}/\1)", source[0])


def plain(_app, what: str, _name: str, _obj, _options, lines: list[str]) -> None:
    """Docstrings are prose: bars, stars and trailing underscores in them mean nothing else."""
    for k, line in enumerate(lines):
        parts = re.split(r"(`[^`]*`)", line)
        parts[::2] = [re.sub(r"([|*\\])|(?<=\w)_(?!\w)", lambda one: "\\" + one[0], part) for part in parts[::2]]
        lines[k] = "".join(parts)
    if what == "module":
        lines[:] = "\n".join(lines).replace(":\n\n    ", "::\n\n    ").splitlines()
        shown = next((k for k, line in enumerate(lines) if line.startswith("    ")), None)
        if shown is not None and not lines[shown - 2].endswith("::"):
            lines[shown:shown] = ["::", ""]


def types_as_said(_app, what: str, _name: str, _obj, _options, lines: list[str]) -> None:
    """Types in docstrings are prose ("(n, 2) of float"), in which only a name by itself leads to an entry."""
    for k, line in enumerate(lines):
        found = re.fullmatch(r"(:type [^:]+:) (.+)", line)
        if found and not re.fullmatch(r"[A-Z]\w+", found[2]):
            lines[k] = found[1] + " ``" + re.sub(r"\\(.)", r"\1", found[2]).replace("`", "") + "``"
    said = [line for line in lines if line.startswith(":type:")]
    if said and what in ("attribute", "property", "data"):
        lines[:] = [line for line in lines if line not in said]
        lines[0] = f"{said[0].removeprefix(':type:').strip()}: {lines[0]}"


def without_second_entry(app, what: str, name: str, obj, _skip: bool, _options) -> bool | None:
    """What `import dynident` takes from a room has its entry there."""
    rooms = [sys.modules[room] for room in documented() if room != "dynident"]
    elsewhere = any(getattr(room, public, None) is obj for room in rooms for public in room.__all__ if public == name)
    if what == "module" and not isinstance(obj, type | FunctionType):
        return True  # add_values says more of it
    return True if what == "module" and elsewhere and app.env.docname.endswith("/dynident") else None


def add_values(_app, _name: str, source: list[str]) -> None:
    """Tables, numbers and kinds of a room, with what their own module says of them; autodoc looks in the room alone."""
    for room in re.findall(r"automodule:: (\S+)", source[0]):
        homes = modules_of(room)
        for public in sys.modules[room].__all__:
            value = getattr(sys.modules[room], public)
            if isinstance(value, type | FunctionType) or public not in homes:
                continue
            said = ModuleAnalyzer.for_module(homes[public]).find_attr_docs().get(("", public), [])
            shown = repr(value).replace("typing.", "")
            lines = [f".. py:data:: {public}", *([f"   :value: {shown}"] if len(shown) < 200 else []), ""]
            source[0] += "\n".join(["", *lines, *(f"   {line}" for line in said), ""])


def modules_of(room: str) -> dict[str, str]:
    """Of every name that a package imports, the module that it comes from."""
    tree = ast.parse(Path(str(sys.modules[room].__file__)).read_text(encoding="utf-8"))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module]
    return {alias.name: str(node.module) for node in imports for alias in node.names}


def documented() -> list[str]:
    """The packages that the reference has a page of."""
    pages = sorted((ROOT / "docs" / "reference").glob("*.rst"))
    return [name for page in pages for name in re.findall(r"automodule:: (\S+)", page.read_text(encoding="utf-8"))]


def setup(app) -> None:
    """Names that are loaded when they are used are loaded now, so that Sphinx sees them."""
    for name in documented():
        module = importlib.import_module(name)
        for public in module.__all__:
            setattr(module, public, getattr(module, public))
    app.connect("source-read", add_contents)
    app.connect("source-read", add_values)
    app.connect("autodoc-skip-member", without_second_entry)
    app.connect("autodoc-process-docstring", plain)
    # After napoleon, which makes fields of the sections.
    app.connect("autodoc-process-docstring", types_as_said, priority=900)
