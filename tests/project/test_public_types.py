"""Public functions and methods say what they take and give: `Any` hides it from editors and type checkers."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import get_type_hints

import pytest
from support.sources import tree_of

from dynident.recordings.recording_metadata import Revision, RevisionFields
from dynident.robot.description_and_json import DescriptionDocument, DriveDocument, LimitsDocument
from dynident.robot.limits_and_drives import Drive, Limits
from dynident.robot.robot_model import Description
from dynident.schema.fields import FieldDescription, FieldOptions

SOURCES = Path(__file__).resolve().parents[2]
PACKAGES = ("src/dynident", "src/dynident_cli", "src/dynident_client", "service/dynident_service")


def test_no_public_function_takes_or_gives_any() -> None:
    trees = {file: tree_of(file) for one in PACKAGES for file in files_of(one)}
    aliases = {(module_of(file), name) for file, tree in trees.items() for name in aliases_of_any(tree)}
    hiding = {file: {"Any", *aliases_of_any(tree), *imported(tree, aliases)} for file, tree in trees.items()}
    found = [
        f"{file.relative_to(SOURCES)}: {name}, {argument}: {ast.unparse(annotation)}"
        for file, tree in trees.items()
        for name, argument, annotation in public_annotations(tree.body)
        if names_in(annotation) & hiding[file]
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("written", "stated"),
    [
        (RevisionFields, Revision),
        (FieldOptions, FieldDescription),
        (LimitsDocument, Limits),
        (DriveDocument, Drive),
        (DescriptionDocument, Description),
    ],
)
def test_keys_are_the_fields_of_what_they_write_out(written: type, stated: type) -> None:
    keys, fields = get_type_hints(written), get_type_hints(stated)
    assert keys == {name: kind for name, kind in fields.items() if (stated, name) != (FieldDescription, "words")}


def files_of(package: str) -> list[Path]:
    """Its modules but those with a leading underscore."""
    found = sorted((SOURCES / package).rglob("*.py"))
    assert found
    return [one for one in found if one.stem == "__init__" or not one.stem.startswith("_")]


def aliases_of_any(tree: ast.Module) -> Iterator[str]:
    """Names of types of a module that have `Any` in them."""
    for one in tree.body:
        match one:
            case ast.Assign(targets=[ast.Name(name)], value=ast.Subscript() | ast.BinOp() | ast.Name() as value):
                if "Any" in names_in(value):
                    yield name


def module_of(file: Path) -> str:
    return ".".join(file.relative_to(SOURCES).with_suffix("").parts[1:])


def imported(tree: ast.Module, aliases: set[tuple[str, str]]) -> Iterator[str]:
    """Names in a module of those aliases of others that it imports."""
    for one in ast.walk(tree):
        if isinstance(one, ast.ImportFrom):
            yield from (name.asname or name.name for name in one.names if (one.module, name.name) in aliases)


def public_annotations(body: list[ast.stmt], within: str = "") -> Iterator[tuple[str, str, ast.expr]]:
    """Of each public function below: its name, the name of an argument or "gives", and the annotation."""
    for one in body:
        match one:
            case ast.ClassDef(name) if not name.startswith("_"):
                yield from public_annotations(one.body, f"{within}{name}.")
            case ast.FunctionDef(name) | ast.AsyncFunctionDef(name) if not name.startswith("_"):
                stated = [node for node in ast.walk(one.args) if isinstance(node, ast.arg)]
                yield from ((within + name, arg.arg, arg.annotation) for arg in stated if arg.annotation)
                if one.returns:
                    yield within + name, "gives", one.returns
            case ast.If():
                yield from public_annotations([*one.body, *one.orelse], within)


def names_in(annotation: ast.expr) -> set[str]:
    """Names that an annotation is made of, those in texts among them."""
    found: set[str] = set()
    for node in ast.walk(annotation):
        match node:
            case ast.Name(name) | ast.Attribute(attr=name):
                found.add(name)
            case ast.Constant(str(text)):
                found |= set(re.findall(r"\w+", text))
    return found
