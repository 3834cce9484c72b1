"""Write docs/effects.md from the catalogue: `python docs/effects_table.py`."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from pathlib import Path

from dynident.effects import CATALOGUE, Effect, ShapeSpec
from dynident.robot import robot_from_library

HERE = Path(__file__).resolve().parent
ROBOT = robot_from_library("ur10")
WHEN = {
    "angle_spectrum": "if the residual has a line in its spectrum over the joint's position",
    "time_spectrum": "if the residual has a line in its spectrum over time that the motion does not have",
    "burst": "if the residual of an interval of time is far above the rest",
}
INTRODUCTION = """\
# The catalogue of effects

These effects can be identified, diagnosed, designed for and simulated. Each is defined once, and is linear in its
parameters for given shape constants. `dynident effects` and `GET /v1/effects` give the same description to programs.
Symbols are those of [Concepts](concepts.md): $q$ is the position of a joint, $\\hat\\tau_l$ the predicted torque of
the links on it, $\\hat\\Gamma$ all of its predicted torque, and $z$ a state that depends on the path. Units are those
of a revolute joint. The shape constants that a diagnosis tries are those of a joint of the UR10; the best of them is
refined.

`rigid_body`, `rotor_inertia`, `coulomb` and `viscous` are in every model by default. You can add [an effect of your
own](own-effects.md).
"""

LIMITS = """\
## Machines that are not rigid links on stiff gears

The model is that of rigid links. What the catalogue has for other machines, and what it lacks:

| machine | in the catalogue | not in it |
|---|---|---|
| elastic joints: harmonic drives, belts, series springs | `joint_elasticity` (one compliance a joint), `backlash`, \
`presliding` | Its formula is of first order in 1/K: it holds for motion well below the lowest resonance, and if the \
twist is small beside the motion. Springs that stiffen, and positions of motor and link side by side, are not \
modelled. |
| elastic links: long or light arms | a bend about a joint's own axis looks like `joint_elasticity` of that joint; a \
vibration at one frequency on all joints is `base_vibration` | Bends across the axis, twists of a link, and modes \
whose frequency depends on the posture are in no effect: they stay in the residual. Move well below the lowest \
resonance. |
| tendons and cables | a known ratio of motors to joints is stated (`coupling`, see [Drive chain](drive-chain.md)) \
or read from the MJCF (see [Closed loops](closed-loops.md)); `transmission_coupling` for a motor that turns two \
neighbouring joints one to one; `joint_elasticity` for stretch; `load_dependent_friction` for pulleys; `cable_force` \
for a spring across two joints | Slack, tension of two tendons that pull against each other, creep, and friction \
that depends on the wrapped angle of several pulleys. |
| quasi-direct drives: legs and arms with gears of 6 to 10 | `torque_ripple` (cogging), `drive_gain_error`, \
`drive_gain_saturation`, `torque_delay`; `rotor_coupling`, whose share beside `rotor_inertia` is one over the gear \
ratio, and so largest here | A gain that falls with the temperature of the winding, losses in the current \
controller. Friction is so small that errors of the current's gain and offset are of its size: check the gains with \
a known load. |
| soft machines: pneumatic muscles, continuum arms | nothing | They have no joints whose positions determine the \
posture, so that the equations of the links do not hold. |

If a diagnosis names none of these effects, the machine need not be rigid. If what is left still depends on the \
motion, the diagnosis says so and on what.
"""


def row(effect: Effect) -> str:
    """One effect as a row of a Markdown table."""
    parameters = ", ".join(f"{spec.name} [{spec.unit}]" for spec in effect.parameters)
    return f"| `{effect.id}` | ${_formula(effect)}$ | {parameters} | {effect.signature} |"


def table() -> str:
    """The whole table."""
    head = "| effect | torque that it adds | parameters | what is left in the residual without it |\n|---|---|---|---|"
    return "\n".join([head, *(row(effect) for effect in CATALOGUE.values())])


def page() -> str:
    """The page of the catalogue."""
    return "\n".join([INTRODUCTION, f"{table()}\n", *(section(effect) for effect in CATALOGUE.values()), LIMITS])


def section(effect: Effect) -> str:
    """One effect as a section."""
    parameters = "; ".join(f"{spec.name} [{spec.unit}], {spec.description}" for spec in effect.parameters)
    lines = [
        f"- **parameters**: {parameters}",
        *(f"- **shape constant**: {_shape(effect, spec)}" for spec in effect.shapes),
        f"- **without it**: {effect.signature}",
        f"- **easily confused with**: {_names(effect.confused_with)}" if effect.confused_with else "",
        f"- **the same function as**: {_names(effect.same_function)}; no data can tell them apart"
        if effect.same_function
        else "",
        f"- **tried**: {_tried(effect)}",
        f"- **sources**: {'; '.join(effect.sources)}",
    ]
    told = " ".join(inspect.cleandoc(type(effect).__doc__ or "").split("\n\n")[0].split())
    listed = "\n".join(line for line in lines if line)
    return f"## {effect.title}: `{effect.id}`\n\n{told}\n\n$${effect.formula}$$\n\n{listed}\n"


def _formula(effect: Effect) -> str:
    return effect.formula.replace("|", r"\vert ")


def _names(identifiers: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in identifiers)


def _shape(effect: Effect, spec: ShapeSpec) -> str:
    if spec.words:
        return f"{spec.name}, {' or '.join(word for _, word in spec.words)} ({spec.description})"
    unit = "" if spec.unit == "-" else f" {spec.unit}"
    joints = effect.applicable(ROBOT)
    if spec.proposal != "grid" or not joints:
        return f"{spec.name}, {spec.description}"
    tried = sorted({round(given[spec.name], 6) for given in effect.grid(ROBOT, joints[0]) if spec.name in given})
    values = [f"{float(f'{value:.3g}'):g}" for value in tried]
    told = f"{spec.name}, {spec.description}"
    if len(tried) == 1:
        return f"{told}: {values[0]}{unit}"
    if len(tried) <= 4:
        return f"{told}: {', '.join(values)}{unit} tried"
    return f"{told}: {len(tried)} values from {values[0]} to {values[-1]}{unit} tried"


def _tried(effect: Effect) -> str:
    if effect.id in ("rigid_body", "rotor_inertia"):
        return "not as a candidate, because every model has it"
    if effect.in_some_runs:
        return "on each run by itself, and on the first and the last few runs, if there are several"
    where = "on the whole robot" if effect.scope == "robot" else "joint by joint"
    if effect.is_friction and effect.scope == "joint":
        where += " and on all joints together"
    conditions = [WHEN[effect.proposal]] if effect.proposal in WHEN else []
    if effect.needs_temperature:
        conditions.append("if temperatures were recorded")
    if effect.needs_session:
        conditions.append("if the times of the runs belong to one session of two minutes or more")
    return ", ".join([where, *conditions])


def write() -> None:
    """Write the page."""
    (HERE / "effects.md").write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    write()
