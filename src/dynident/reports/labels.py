"""Names of effects, joints, shape constants and ladder steps, and words of judgements, as people read them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from dynident.array_types import FloatArray
from dynident.effects import CATALOGUE, EffectChoice, get_effect
from dynident.identification.identified_models.held_out_gain import BestStep
from dynident.identification.shape_constant_intervals import ShapeConstant, ShapeJudgement
from dynident.identification.thresholds import LARGEST_CONDITION_NUMBER, ParameterJudgement
from dynident.number_format import NARROW_SPACE, format_estimate, format_number
from dynident.reports.table_cells import Mark
from dynident.robot import Robot
from dynident.robot.joint import join_joint_names
from dynident.robot.json_fields import join_names

if TYPE_CHECKING:
    # For type checkers alone: most users of this module need no diagnosis, which takes long to load.
    from dynident.diagnosis import Diagnosis
    from dynident.identification import Identification

_MANY_JOINTS = 8


def format_joints(joints: Sequence[str], all_joints: Sequence[str]) -> str:
    """Return the names of some joints as text.

    Parameters
    ----------
    joints : sequence of str
        Names of the joints; empty: the effect belongs to the whole robot.
    all_joints : sequence of str
        All joints of the robot.

    Returns
    -------
    str
        Their names; of many joints those that are left out ("all but knee"), left and right together.
    """
    return join_joint_names(joints, all_joints) if joints else "the whole robot"


def describe_condition_number(identification: Identification) -> str:
    """Return the equilibrated condition number of W and what it means.

    Parameters
    ----------
    identification : Identification
        The identified model.

    Returns
    -------
    str
        Without a full stop: "12.3 (columns of equal size; …)".
    """
    value = format_number(identification.equilibrated_condition_number)
    return f"{value} ({CONDITION_MEANING})"


CONDITION_MEANING = (
    "columns of equal size; 1 is the best, and above "
    f"{LARGEST_CONDITION_NUMBER:.0f} the motion alone does not determine the model well"
)


def format_hidden_effects(diagnosis: Diagnosis, robot: Robot) -> str:
    """Return the effects that the data could not have shown: each once, with its joints where not all are meant.

    Parameters
    ----------
    diagnosis : Diagnosis
        The diagnosis.
    robot : Robot
        The robot that the model is of.

    Returns
    -------
    str
        "" where there are none.
    """
    joints: dict[str, set[str]] = {}
    # A diagnosis lists effect and joints pair by pair; a reader wants each effect once.
    for item in diagnosis.not_visible:
        joints.setdefault(item.effect, set()).update(item.joints or robot.joint_names)
    texts = []
    for effect, names in joints.items():
        where = f" on {join_names(name for name in robot.joint_names if name in names)}" if len(names) < robot.n else ""
        texts.append(f"{get_effect(effect).title}{where}")
    return "; ".join(texts)


def format_shape_constants(choice: EffectChoice) -> str:
    """Return the shape constants of an effect with their units; a constant that is a choice appears as its word.

    Parameters
    ----------
    choice : EffectChoice
        The effect with its shape constants.

    Returns
    -------
    str
        The constants, with commas between them.
    """
    specs = {spec.name: spec for spec in get_effect(choice.effect).shapes}
    return ", ".join(specs[name].format_value(value) for name, value in choice.shape)


def format_shape_interval(constant: ShapeConstant) -> str:
    """Return the 95 % interval of a shape constant; "–" where it has none.

    Parameters
    ----------
    constant : ShapeConstant
        The shape constant.

    Returns
    -------
    str
        Both ends, with the decimals that the standard deviation allows.
    """
    if constant.interval is None:
        return "–"
    return " to ".join(format_estimate(end, constant.standard_deviation)[0] for end in constant.interval)


def format_standstill_shares(shares: FloatArray) -> str:
    """Return the shares of time in which joints stand still, in per cent; of many joints the least and the largest.

    Parameters
    ----------
    shares : (n,) array
        Fractions, in the robot's order of joints.

    Returns
    -------
    str
        The shares, with the sign of per cent once.
    """
    if len(shares) > _MANY_JOINTS:
        return f"{100 * shares.min():.0f} to {100 * shares.max():.0f}{NARROW_SPACE}%"
    return f"{', '.join(f'{100 * share:.0f}' for share in shares)}{NARROW_SPACE}%"


def get_effect_title(identifier: str) -> str:
    """Return an effect's title, or its id in words where it is not in the catalogue.

    An effect that is equivalent to a finding need not be in the catalogue: some effects are the same function.

    Parameters
    ----------
    identifier : str
        The effect's id.

    Returns
    -------
    str
        The title.
    """
    return CATALOGUE[identifier].title if identifier in CATALOGUE else identifier.replace("_", " ")


def get_step_mark(best_step: BestStep | None, index: int, count: int) -> str:
    """Return the mark of one step of a ladder on held-out data: best, or with an error that rises again.

    Parameters
    ----------
    best_step : BestStep or None
        Which model predicts held-out data best, where that is known.
    index : int
        Index of the step, from 0.
    count : int
        Number of models of the ladder.

    Returns
    -------
    str
        "" where there is nothing to choose from.
    """
    if best_step is None or count < 2:
        return ""
    return "✓ best" if index == best_step.best else "↑ rises" if index in best_step.rises else ""


def describe_best_step(best_step: BestStep | None, count: int) -> str:
    """Return the sentence that says which model of a ladder predicts held-out data best.

    Parameters
    ----------
    best_step : BestStep or None
        Which model predicts held-out data best, where that is known.
    count : int
        Number of models of the ladder.

    Returns
    -------
    str
        "" where there is nothing to choose from.
    """
    if best_step is None or count < 2:
        return ""
    best = f"Model {best_step.best + 1} predicts held-out data best"
    if not best_step.rises:
        return f"{best}."
    rise = best_step.rises[0] + 1
    return f"{best}; from model {rise} on the held-out error is larger: the steps from there on do not help."


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
