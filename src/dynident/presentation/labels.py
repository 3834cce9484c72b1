"""Names of effects, joints and shape constants, and words of judgements, as people read them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from dynident.array_types import FloatArray
from dynident.effects import CATALOGUE, EffectChoice, get_effect
from dynident.identification.shape_constant_intervals import ShapeConstant, ShapeJudgement
from dynident.identification.thresholds import LARGEST_CONDITION_NUMBER, ParameterJudgement
from dynident.number_format import NARROW_SPACE, format_estimate, format_number
from dynident.presentation.tables import Mark
from dynident.robot import Robot
from dynident.robot.joint import MANY_NAMES, join_joint_names

if TYPE_CHECKING:
    # For type checkers alone: most users of this module need no diagnosis, which takes long to load.
    from dynident.diagnosis import Diagnosis
    from dynident.identification import Identification

_MANY_JOINTS = 8


def format_joints(joints: Sequence[str], all_joints: Sequence[str], most: int | None = None) -> str:
    """Return the names of some joints as text.

    Parameters
    ----------
    joints : sequence of str
        Names of the joints; empty: the effect belongs to the whole robot.
    all_joints : sequence of str
        All joints of the robot. Of many joints those that are left out are named ("all but knee").
    most : int, optional
        Of more names than these only the number of joints is given.
    """
    return join_joint_names(joints, all_joints, most) if joints else "the whole robot"


def format_choice(choice: EffectChoice, all_joints: Sequence[str]) -> str:
    """Return an effect with its joints and shape constants: "Stribeck friction on elbow (vs = 0.1 rad/s)"."""
    in_catalogue = CATALOGUE.get(choice.effect)
    place = f" on {join_joint_names(choice.joints or all_joints, all_joints)}"
    where = "" if in_catalogue is not None and in_catalogue.scope == "robot" else place
    shape = f" ({format_shape_constants(choice)})" if choice.shape else ""
    return f"{get_effect_title(choice.effect)}{where}{shape}"


def describe_condition_number(identification: Identification) -> str:
    """Return the scaled condition number of W, with columns of equal size, and what it means."""
    value = format_number(identification.equilibrated_condition_number)
    return f"{value} ({CONDITION_MEANING})"


CONDITION_MEANING = (
    "columns of equal size; 1 is the best, and above "
    f"{LARGEST_CONDITION_NUMBER:.0f} the motion alone does not determine the model well"
)


def describe_estimator(identification: Identification) -> str:
    """Return the estimator's name with its options, and what it came to where the data decide that."""
    solver = identification.choices.solver
    if not solver.possible_where_free:
        return solver.name_with_options
    became = "weighted least squares" if identification.estimate.standard is None else "feasible parameters"
    return f"{solver.name_with_options}: {became}"


def format_hidden_effects(diagnosis: Diagnosis, robot: Robot) -> str:
    """Return the effects that the data could not have shown: each once, with its joints where not all are meant.

    Parameters
    ----------
    diagnosis : Diagnosis
        The diagnosis.
    robot : Robot
        The robot that the model is of.
    """
    joints: dict[str, set[str]] = {}
    # A diagnosis lists effect and joints pair by pair; a reader wants each effect once.
    for item in diagnosis.not_visible:
        joints.setdefault(item.effect, set()).update(item.joints or robot.joint_names)
    texts = []
    for effect, names in joints.items():
        some = [name for name in robot.joint_names if name in names]
        where = f" on {join_joint_names(some, robot.joint_names, MANY_NAMES)}" if len(names) < robot.n else ""
        texts.append(f"{get_effect(effect).title}{where}")
    return "; ".join(texts)


def format_shape_constants(choice: EffectChoice) -> str:
    """Return the shape constants of an effect with their units; a constant that is a choice appears as its word."""
    specs = {spec.name: spec for spec in get_effect(choice.effect).shapes}
    return ", ".join(specs[name].format_value(value) for name, value in choice.shape)


def format_shape_interval(constant: ShapeConstant) -> str:
    """Return the 95 % interval of a shape constant; "–" where it has none."""
    if constant.interval is None:
        return "–"
    return " to ".join(format_estimate(end, constant.standard_deviation)[0] for end in constant.interval)


def format_standstill_shares(shares: FloatArray) -> str:
    """Return the shares of time in which joints stand still, in per cent; of many joints the least and the largest."""
    if len(shares) > _MANY_JOINTS:
        return f"{100 * shares.min():.0f} to {100 * shares.max():.0f}{NARROW_SPACE}%"
    return f"{', '.join(f'{100 * share:.0f}' for share in shares)}{NARROW_SPACE}%"


def get_effect_title(identifier: str) -> str:
    """Return an effect's title, or its id in words where it is not in the catalogue.

    An effect that is equivalent to a finding need not be in the catalogue: some effects are the same function.
    """
    return CATALOGUE[identifier].title if identifier in CATALOGUE else identifier.replace("_", " ")


@dataclass(frozen=True)
class MarkedText:
    """Words with a mark that says whether they are good news."""

    words: str
    mark: Mark


PARAMETER_JUDGEMENTS: Mapping[ParameterJudgement, MarkedText] = MappingProxyType(
    {
        "determined": MarkedText("✓ determined", "ok"),
        "uncertain": MarkedText("! uncertain", "warning"),
        "zero_in_interval": MarkedText("0 in interval", "plain"),
        "held": MarkedText("held", "plain"),
    }
)
"""Words and mark for the judgement of a parameter by its interval."""


SHAPE_JUDGEMENTS: Mapping[ShapeJudgement, MarkedText] = MappingProxyType(
    {
        "determined": MarkedText("✓ determined", "ok"),
        "uncertain": MarkedText("! uncertain", "warning"),
        "not_determined": MarkedText("✕ not determined", "warning"),
        "at_edge": MarkedText("! at the edge", "warning"),
        "elsewhere": MarkedText("! another value fits the data", "warning"),
        "chosen": MarkedText("chosen", "plain"),
        "not_looked_at": MarkedText("not examined", "plain"),
    }
)
"""Words and mark for the judgement of a shape constant."""
