"""Write a line for each module, from its docstring, into docs/architecture.md: `python docs/list_modules.py`."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "architecture.md"
PACKAGES = ("src/dynident", "src/dynident_cli", "src/dynident_client", "service/dynident_service")
# One step of the database's history each.
LEFT_OUT = "migrations"
# Packages that are generated: the package has a line, its modules have none.
GENERATED = "answers"
# A second paragraph of up to so many characters, in sentences, belongs to the line; a longer one explains.
LONGEST_SECOND = 135
SCRIPTS = "service/dynident_service/workbench/static/js"
LIST = re.compile(r"(<!-- python docs/list_modules.py -->\n).*?(\n<!-- end of the modules -->)", re.DOTALL)


def list_modules() -> str:
    """Return the list: the packages with their modules, then the scripts of the workbench."""
    folders = {file.parent for package in PACKAGES for file in (ROOT / package).rglob("*.py")}
    sections = [section for folder in sorted(folders) if (section := _list_package(folder))]
    return "\n\n".join([*sections, _list_scripts()])


def _list_package(folder: Path) -> str:
    name = folder.relative_to(ROOT).as_posix()
    if LEFT_OUT in folder.parts:
        return ""
    files = sorted(file for file in folder.glob("*.py") if file.name != "__init__.py" and folder.name != GENERATED)
    about = _read_docstring(folder / "__init__.py") if (folder / "__init__.py").exists() else ""
    return "\n".join([f"### {name}", "", about, "", *(f"- `{file.stem}`: {_read_docstring(file)}" for file in files)])


def _list_scripts() -> str:
    lines = []
    for file in sorted((ROOT / SCRIPTS).rglob("*.js")):
        comment = re.match(r"(?://.*\n)+", file.read_text(encoding="utf-8"))
        text = " ".join(line.removeprefix("//").strip() for line in comment.group().splitlines()) if comment else ""
        lines.append(f"- `{file.relative_to(ROOT / SCRIPTS).as_posix()}`: {text}")
    return "\n".join([f"### {SCRIPTS}", "", *lines])


def _read_docstring(file: Path) -> str:
    """Return the first paragraph of a module's docstring on one line, and the second one if it is short."""
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    first, *others = (" ".join(paragraph.split()) for paragraph in text.split("\n\n"))
    belonging = [second for second in others[:1] if len(second) <= LONGEST_SECOND and second.endswith(".")]
    return " ".join([first, *belonging])


if __name__ == "__main__":
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(LIST.sub(lambda found: found[1] + list_modules() + found[2], page), encoding="utf-8")
