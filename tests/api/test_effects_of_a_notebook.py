"""An effect that is defined in a notebook is used by its id, for this process."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import dynident as dy
from dynident.effects import CATALOGUE, Effect

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "own-effects.md").read_text(encoding="utf-8")


@pytest.fixture
def hose(restored_catalogue: None) -> type[Effect]:
    """The effect of the page about effects of one's own; the catalogue is put back afterwards."""
    block = re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert block
    namespace: dict[str, Any] = {}
    exec(block[1].replace("from __future__ import annotations", ""), namespace)
    found: type[Effect] = namespace["HoseFriction"]
    return found


def test_a_registered_effect_is_identified_extended_and_diagnosed_by_its_id(
    hose: type[Effect], model: dy.Model, runs: dy.Recordings, robot: dy.Robot
) -> None:
    with pytest.raises(dy.DynidentError, match="no effect 'hose_friction'"):
        model.extend("hose_friction@elbow")
    assert dy.register(hose) is hose
    assert "Fh2" in model.extend("hose_friction@elbow").params
    assert "Fh2" in dy.identify(robot, runs[:1], effects=["default", "hose_friction@elbow:q0=0.1"]).params
    found = dy.diagnose(model, candidates=["hose_friction"])
    assert {one.effect for one in found.candidates} <= {"hose_friction"}


def test_registering_again_replaces_it_and_ids_of_others_are_refused(hose: type[Effect]) -> None:
    dy.register(hose)
    dy.register(hose())
    assert [name for name in CATALOGUE if name == "hose_friction"] == ["hose_friction"]
    with pytest.raises(dy.DynidentError, match="belongs to another effect, Stribeck"):
        dy.register(type("Mine", (hose,), {"id": "stribeck"}))
    assert CATALOGUE["stribeck"].title.startswith("Stribeck")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"title": ""}, "does not define its title"),
        ({"id": "Hose Friction"}, "not in small letters"),
        ({"confused_with": ("nothing_known",)}, "which is not another effect"),
        ({"columns": lambda *_: 1 / 0}, "ZeroDivisionError"),
    ],
)
def test_what_does_not_conform_is_refused_with_the_reason(
    hose: type[Effect], change: dict[str, Any], words: str
) -> None:
    with pytest.raises(dy.DynidentError, match=words):
        dy.register(type("Mine", (hose,), change))
    assert "hose_friction" not in CATALOGUE


def test_a_file_with_it_says_in_another_process_that_it_has_to_be_registered(
    hose: type[Effect], model: dy.Model, tmp_path: Path
) -> None:
    dy.register(hose)
    model.extend("hose_friction@elbow").save(tmp_path / "own.npz")
    assert dy.load_model(tmp_path / "own.npz").effects[-1].effect == "hose_friction"
    code = "import dynident as dy\ntry: dy.load_model('own.npz')\nexcept dy.DynidentError as error: print(error)"
    ended = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    told = ended.stdout
    assert "hose_friction" in told
    assert "dy.register" in told
