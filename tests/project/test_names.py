"""Names of the code follow docs/glossary.md: verbs for functions, nouns for values and modules."""

from __future__ import annotations

import ast
import re
from collections import Counter
from pathlib import Path

from support.sources import tree_of

ROOT = Path(__file__).resolve().parents[2]
MODULES = sorted(path for folder in ("src", "service") for path in (ROOT / folder).rglob("*.py"))

IRREGULAR = frozenset(
    [
        "told",
        "said",
        "taken",
        "kept",
        "known",
        "shown",
        "made",
        "found",
        "given",
        "held",
        "lost",
        "met",
        "sent",
        "sold",
        "taught",
        "thought",
        "understood",
        "won",
        "written",
        "chosen",
        "driven",
        "drawn",
        "begun",
        "done",
        "gone",
        "grown",
        "hidden",
        "led",
        "meant",
        "sought",
        "spoken",
        "thrown",
        "worn",
        "bound",
        "brought",
        "bought",
        "caught",
        "felt",
        "fought",
        "got",
        "heard",
        "hurt",
        "lent",
        "lit",
        "seen",
    ]
)
ENDS_LIKE_ONE = frozenset({"seed", "speed", "need", "feed", "embed", "succeed"})
VAGUE = ("one", "found", "made", "told", "said", "kept", "wanted", "asked")
MOST_VAGUE = 20
DOCUMENTED = {
    "converged",
    "elapsed",
    "kept",
    "limited",
    "passed",
    "predicted",
    "proposed",
    "recommended",
    "removed",
    "said",
    "shown",
}
"""Names that users or templates read as data, or that documents show; no new ones."""


def parse_modules() -> dict[Path, ast.Module]:
    return {path: tree_of(path) for path in MODULES}


def is_participle(name: str) -> bool:
    word = name.strip("_")
    if word in ENDS_LIKE_ONE or "_" in word:
        return False
    return word in IRREGULAR or re.fullmatch(r"[a-z]{2,}ed", word) is not None


def test_functions_are_named_by_verbs_and_not_by_participles() -> None:
    found = {
        f"{path.relative_to(ROOT)}:{node.name}"
        for path, tree in parse_modules().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        if is_participle(node.name) and node.name not in DOCUMENTED
    }
    assert found == set()


def test_values_are_named_by_what_they_hold() -> None:
    count = Counter(
        node.id
        for tree in parse_modules().values()
        for node in ast.walk(tree)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    )
    assert sum(count[name] for name in VAGUE) <= MOST_VAGUE, {name: count[name] for name in VAGUE}


def test_modules_are_called_by_what_is_in_them() -> None:
    # An equation type, which requests name `filtered`, has a file of its name.
    participles = [path.name for path in MODULES if is_participle(path.stem) and path.parent.parent.name != "methods"]
    assert participles == []


def test_no_word_of_the_old_dialect_names_a_class() -> None:
    banned = {
        "Nursery",
        "Crew",
        "Colleagues",
        "Yardstick",
        "Kept",
        "Told",
        "Said",
        "Asked",
        "Wanted",
        "Shown",
        "Beside",
    }
    classes = {
        node.name for tree in parse_modules().values() for node in ast.walk(tree) if isinstance(node, ast.ClassDef)
    }
    assert classes & banned == set()


def test_no_name_contains_a_word_that_the_glossary_replaces() -> None:
    # Fields of the contract keep their names.
    fields = {"rung", "rungs", "stretches"}
    replaced = {"rung", "rungs", "pick", "picks", "mistake", "mistakes", "stretch", "stretches", "rooms"}
    names = {
        f"{path.relative_to(ROOT)}: {name}"
        for path, tree in parse_modules().items()
        for node in ast.walk(tree)
        for name in (
            getattr(node, "name", None),
            getattr(node, "arg", None),
            node.id if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) else None,
        )
        if isinstance(name, str) and name not in fields
        # Words as they stand in WorstInterval, n_blocks, _MOST_BLOCKS.
        if replaced & {word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)}
    }
    assert names == set()


def test_every_word_of_the_glossary_stands_once() -> None:
    rows = re.findall(r"(?m)^\| ([^|]+) \| [^|]+ \|", (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8"))
    words = Counter(row.strip() for row in rows if row.strip() not in ("word", "---"))
    assert [word for word, count in words.items() if count > 1] == []


def test_estimation_knows_no_joints() -> None:
    """It has rows with weights and groups; which joint stands or reverses in them, those know that make the rows."""
    banned = {"joint", "joints", "robot", "friction", "halt", "halts", "reversal", "reversals", "reversing", "standing"}
    named = {
        f"{path.name}: {name}"
        for path, tree in parse_modules().items()
        if path.parent == ROOT / "src/dynident/estimation"
        for node in ast.walk(tree)
        for name in (
            getattr(node, "name", None),
            getattr(node, "id", None),
            getattr(node, "attr", None),
            getattr(node, "arg", None),
        )
        if isinstance(name, str) and banned & set(re.findall(r"[a-z]+", name.lower()))
    }
    assert named == set()
