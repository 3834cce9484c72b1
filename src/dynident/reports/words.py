"""Effects, joints and rungs in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from dynident.arrays import FloatArray
from dynident.effects import CATALOGUE, EffectChoice, effect_by_id
from dynident.identification.parameters.judgement import ParameterJudgement
from dynident.identification.shapes.shape_constants import ShapeConstant, ShapeJudgement
from dynident.identification.study.gain import BestRung
from dynident.reports.numbers import estimate
from dynident.reports.tables import Mark
from dynident.robot import Robot
from dynident.robot.pointers import listed

if TYPE_CHECKING:
    # Many who need words need no diagnosis, which takes long to load.
    from dynident.diagnosis import Diagnosis

_MANY_JOINTS = 8


def place_text(joints: Sequence[str], all_joints: Sequence[str]) -> str:
    """Joints of a robot in words."""
    if len(joints) == len(all_joints) > 1:
        return "all joints"
    return ", ".join(joints) or "the whole robot"


def hidden_text(found: Diagnosis, robot: Robot) -> str:
    """What the data could not have shown: each effect once, with its joints where it is not all of them."""
    joints: dict[str, set[str]] = {}
    for item in found.not_visible:
        joints.setdefault(item.effect, set()).update(item.joints or robot.joint_names)
    texts = []
    for effect, names in joints.items():
        where = f" on {listed(name for name in robot.joint_names if name in names)}" if len(names) < robot.n else ""
        texts.append(f"{effect_by_id(effect).title}{where}")
    return "; ".join(texts)


def shape_text(choice: EffectChoice) -> str:
    """Shape constants with their units; what is a choice between kinds in words."""
    specs = {spec.name: spec for spec in effect_by_id(choice.effect).shapes}
    return ", ".join(specs[name].told(value) for name, value in choice.shape)


def interval_text(constant: ShapeConstant) -> str:
    """The 95 % interval of a shape constant; "–" where no number says how sure it is."""
    if constant.interval is None:
        return "–"
    return " to ".join(estimate(end, constant.standard_deviation)[0] for end in constant.interval)


def standing_text(shares: FloatArray) -> str:
    """Shares (n,) of time that joints stand, in the robot's order, in per cent; of many joints the least and most."""
    if len(shares) > _MANY_JOINTS:
        return f"{100 * shares.min():.0f} to {100 * shares.max():.0f} %"
    return f"{', '.join(f'{100 * share:.0f}' for share in shares)} %"


def title_of(identifier: str) -> str:
    """An effect's title; its id in words where the catalogue does not hold it.

    What is equivalent to a finding need not be in the catalogue: some effects are the same function.
    """
    return CATALOGUE[identifier].title if identifier in CATALOGUE else identifier.replace("_", " ")


def rung_mark(found: BestRung | None, index: int, count: int) -> str:
    """What a rung of a ladder of so many models is on held-out data; "" where there is nothing to choose."""
    if found is None or count < 2:
        return ""
    return "✓ best" if index == found.best else "↑ rises" if index in found.rises else ""


def best_rung_text(found: BestRung | None, count: int) -> str:
    """Which model of a ladder predicts held-out data best, in a sentence; "" where there is nothing to choose."""
    if found is None or count < 2:
        return ""
    best = f"Model {found.best + 1} predicts held-out data best"
    if not found.rises:
        return f"{best}."
    return (
        f"{best}; from model {found.rises[0] + 1} on the held-out error is larger: what was added there does not help."
    )


@dataclass(frozen=True)
class Marked:
    """Words, and whether they are good news: the class of a mark."""

    words: str
    mark: Mark


JUDGED: Mapping[ParameterJudgement, Marked] = MappingProxyType(
    {
        "determined": Marked("✓ determined", "ok"),
        "uncertain": Marked("! uncertain", "warning"),
        "zero_in_interval": Marked("0 in interval", "plain"),
    }
)
"""What the interval says of a parameter."""


SHAPES_JUDGED: Mapping[ShapeJudgement, Marked] = MappingProxyType(
    {
        "determined": Marked("✓ determined", "ok"),
        "uncertain": Marked("! uncertain", "warning"),
        "not_determined": Marked("✕ not determined", "warning"),
        "at_edge": Marked("! at the edge", "warning"),
        "elsewhere": Marked("! elsewhere in the data", "warning"),
        "chosen": Marked("chosen", "plain"),
        "not_looked_at": Marked("not looked at", "plain"),
    }
)
"""What the data say of a shape constant."""
