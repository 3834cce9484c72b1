"""Nothing but an effect's own file knows it by name."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.sources import tree_of

from dynident.effects import CATALOGUE, DEFAULT_EFFECTS

ROOT = Path(__file__).resolve().parents[2]
HOME = ROOT / "src" / "dynident" / "effects"
PYTHON = sorted(
    path for folder in ("src", "service") for path in (ROOT / folder).rglob("*.py") if HOME not in path.parents
)
PAGES = sorted((ROOT / "service").rglob("*.js"))

# "payload" is as well what a recording carries, a role of recordings and a kind of validation: there it names no
# effect. Where somebody compares an effect with it, or asks for one, it does.
OTHER_MEANINGS = {"payload"}

# The contract (api.md) fixes the four usual effects as the defaults of a request, and the demonstration's default is in
# its help; who says "the links" there says it in the contract's words.
CONTRACT = {
    "service/dynident_service/identifications/wire_types.py": {choice.effect for choice in DEFAULT_EFFECTS},
    "service/dynident_service/designs/wire_types.py": {choice.effect for choice in DEFAULT_EFFECTS},
    "service/dynident_service/robots/adapters.py": {"rigid_body"},
    "src/dynident_cli/commands/design.py": {"stribeck"},
    # A check of recordings has the name of what it looks for; a URDF's mimic joint has an offset.
    "src/dynident/recordings/recording_metadata.py": {"torque_delay"},
    # What is said of a recording has a field of that name.
    "src/dynident/reports/sections/provenance.py": {"torque_delay"},
    "src/dynident/api/proposed_metadata.py": {"torque_delay"},
    "src/dynident/robot/urdf_writer.py": {"offset"},
    # A part of a robot has the name of the effect that it has.
    "src/dynident/robot/limits_and_drives.py": {"gravity_compensator"},
    "src/dynident/robot/urdf_reader.py": {"offset"},
    # And so have the numbers of a mesh in COLLADA.
    "src/dynident/robot/collada.py": {"offset"},
    "service/dynident_service/workbench/static/js/identification_form.js": {c.effect for c in DEFAULT_EFFECTS},
    # Sample data have the demonstration's hidden effect.
    "service/dynident_service/workbench/static/js/first_model.js": {*(c.effect for c in DEFAULT_EFFECTS), "stribeck"},
}


def named(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Lines of a Python module at which the id of an effect stands as a string, and the id."""
    meant = {id(node) for whole in ast.walk(tree) for node in _of_effects(whole)}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Constant) or not isinstance(node.value, str):
            continue
        if node.value in CATALOGUE and (node.value not in OTHER_MEANINGS or id(node) in meant):
            yield node.lineno, node.value


def _of_effects(node: ast.AST) -> list[ast.AST]:
    """Everything inside a comparison with somebody's `.effect`, or inside a choice of an effect."""
    compared = isinstance(node, ast.Compare) and any(
        isinstance(part, ast.Attribute) and part.attr == "effect" for part in (node.left, *node.comparators)
    )
    chosen = isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("EffectChoice", "TrueEffect")
    return list(ast.walk(node)) if compared or chosen else []


@pytest.mark.parametrize(
    "source",
    [
        'if column.effect == "coulomb": pass',
        'COMMON = ("stribeck", "x")',
        'EffectChoice("payload", runs=())',
        'if column.effect in ("rigid_body", "payload"): pass',
    ],
)
def test_the_search_finds_an_effect_that_is_known_by_name(source: str) -> None:
    assert list(named(ast.parse(source)))


def test_the_search_leaves_a_payload_that_is_no_effect() -> None:
    assert not list(named(ast.parse('body.get("payload"); role == "payload"')))


def test_no_effect_is_known_by_name_outside_its_own_room() -> None:
    found = [
        f"{name}:{line}: {effect}"
        for path in PYTHON
        for line, effect in named(tree_of(path))
        if effect not in CONTRACT.get(name := path.relative_to(ROOT).as_posix(), ())
    ]
    assert len(PYTHON) > 400
    assert found == []


def test_no_page_knows_an_effect_by_name() -> None:
    ids = "|".join(name for name in CATALOGUE if name not in OTHER_MEANINGS)
    quoted = re.compile(rf"""["'`]({ids})["'`]""")
    found = [
        f"{name}: {effect}"
        for path in PAGES
        for effect in quoted.findall(path.read_text(encoding="utf-8"))
        if effect not in CONTRACT.get(name := path.relative_to(ROOT).as_posix(), ())
    ]
    assert PAGES
    assert found == []
