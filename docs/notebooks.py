"""The tutorial and the page about notebooks as Jupyter notebooks: `python docs/notebooks.py [FOLDER]`.

Needs `pip install 'dynident[docs]'`. Each is one file, with its figures in it, and runs as it is: commands are cells of
the shell. What a page says is not run stays text.
"""

from __future__ import annotations

import base64
import re
import sys
from pathlib import Path

import jupytext

HERE = Path(__file__).resolve().parent
PAGES = ("tutorial", "notebook")
HEADER = "---\njupyter:\n  kernelspec:\n    display_name: Python 3\n    language: python\n    name: python3\n---\n\n"


def notebook(page: str) -> str:
    """A page of docs/ as a notebook, in Jupyter's format."""
    text = (HERE / f"{page}.md").read_text(encoding="utf-8")
    text = re.sub(r"<!-- not run: .+ -->\n```(\w+)\n", r"```\1 .noeval\n", text)
    text = re.sub(r"\]\((figures/\w+\.svg)\)", lambda found: f"]({_inside(HERE / found[1])})", text)
    return str(jupytext.writes(jupytext.reads(HEADER + text, "md"), "ipynb"))


def _inside(figure: Path) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(figure.read_bytes()).decode()


def write(folder: Path) -> None:
    """All of them."""
    folder.mkdir(parents=True, exist_ok=True)
    for page in PAGES:
        (folder / f"{page}.ipynb").write_text(notebook(page), encoding="utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else Path.cwd())
