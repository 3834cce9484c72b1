"""Build the pool of candidates: every effect of the catalogue, joint by joint and on all, for every shape constant.

Holds why an effect is not tried (too short a session, too narrow for the filters, no suitable joint).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from dynident.diagnosis.residuals.resolution_at_reversals import Resolution
from dynident.diagnosis.residuals.shape_proposals import ShapeProposals
from dynident.effects import CATALOGUE, Column, Effect, EffectChoice, build_columns, get_effect
from dynident.effects.effect_columns import is_lasting_change, list_possible_joints
from dynident.effects.effect_signals import Signals
from dynident.regressors.model_structure import Model
from dynident.regressors.observation_matrix import Observation
from dynident.robot.robot_model import Robot

# s: within less, nothing warms up, and what drifts is something else.
_SHORTEST_SESSION = 120.0

# Grids of speeds and distances go by factors of two.
_HALF_A_STEP = 2.0**0.5


@dataclass(frozen=True)
class Candidate:
    """One effect at one place with one set of shape constants.

    Parameters
    ----------
    effect : str
        Id of the effect in the catalogue.
    joints : tuple of str
        Names of the joints that it acts on; none for the whole robot.
    shape : tuple of (str, float)
        Shape constants.
    columns : tuple of int
        Its columns in the pool.
    runs : tuple of str
        Labels of the runs in which it acts; all where there are none.
    """

    effect: str
    joints: tuple[str, ...]
    shape: tuple[tuple[str, float], ...]
    columns: tuple[int, ...]
    runs: tuple[str, ...] = ()

    @property
    def choice(self) -> EffectChoice:
        """The candidate as a choice that can be added to a model."""
        return EffectChoice(self.effect, self.joints, self.shape, self.runs)


@dataclass(frozen=True, eq=False)
class Pool:
    """The candidates of a diagnosis, and the columns of model and candidates.

    Parameters
    ----------
    observation : Observation
        Columns of the model, and behind them those of all candidates.
    n_base : int
        Number of columns of the model.
    candidates : tuple of Candidate
        The candidates.
    since : tuple of str
        Labels of the later runs, where changes between them and the others are looked for.
    faint : frozenset[Candidate]
        Candidates that are tried only once something was found on their joint.
    largest : mapping of (str, str) to float
        Largest size that the positions alone allow an effect on a joint, by effect and joint.
    """

    observation: Observation
    n_base: int
    candidates: tuple[Candidate, ...]
    since: tuple[str, ...] = ()
    faint: frozenset[Candidate] = frozenset()
    largest: Mapping[tuple[str, str], float] = field(default_factory=dict)

    @property
    def initial_candidates(self) -> list[Candidate]:
        """The candidates that a search begins with: those that may last, and are not faint."""
        return [
            candidate
            for candidate in self.candidates
            if not get_effect(candidate.effect).is_transient and candidate not in self.faint
        ]

    def build_candidate(self, choice: EffectChoice, signals: Signals) -> Candidate:
        """Return the candidate of a choice whose columns the pool has, by this or another name."""
        index = {column.key: k for k, column in enumerate(self.observation.columns)}
        numbers = (index[column.key] for column in build_columns([choice], signals) if column.key in index)
        columns = tuple(k for k in numbers if k >= self.n_base)
        return Candidate(choice.effect, choice.joints, choice.shape, columns, choice.runs)

    def find_candidate(self, choice: EffectChoice) -> Candidate | None:
        """Return the candidate of a choice; None where all its columns are the model's, or zero."""
        return next((candidate for candidate in self.candidates if candidate.choice == choice), None)

    def find_joints(self, columns: tuple[int, ...]) -> tuple[int, ...]:
        """Return the joints whose torque some columns contribute to."""
        return tuple(sorted(set[int]().union(*(self._joints_of_columns[k] for k in columns))))

    @cached_property
    def _joints_of_columns(self) -> list[list[int]]:
        # W has an entry wherever a column gives torque on a joint.
        joints: list[list[int]] = [[] for _ in self.observation.columns]
        for joint, column in zip(self.observation.entry_rows, self.observation.entry_columns, strict=True):
            joints[column].append(int(joint))
        return joints

    def is_change(self, candidate: Candidate) -> bool:
        """Return whether a candidate is something that the later runs have and the others have not."""
        return is_lasting_change(candidate.choice, self.since)


def build_pool(
    model: Model,
    effects: Sequence[str] | None = None,
    leads: ShapeProposals | None = None,
    resolved: Resolution | None = None,
    earlier: Pool | None = None,
    refined: Sequence[EffectChoice] = (),
) -> Pool:
    """Build the columns of a model and of everything that might be missing in it.

    Parameters
    ----------
    model : Model
        The model in question.
    effects : sequence of str, optional
        Ids of the effects to try; all of the catalogue otherwise.
    leads : ShapeProposals, optional
        Shape constants that the residual suggests; without them only effects with a grid are offered.
    resolved : Resolution, optional
        What the data can resolve: shape constants below it are not offered.
    earlier : Pool, optional
        A pool with fewer proposals, whose columns stand first.
    refined : sequence of EffectChoice
        What was found, with shape constants that are none of the grid.

    Returns
    -------
    Pool
        The pool.
    """
    # The links and rotors are the model itself: without them nothing can be diagnosed.
    chosen = [CATALOGUE[name] for name in (effects or CATALOGUE) if not CATALOGUE[name].is_inertia]
    proposals = leads or ShapeProposals()
    choices = [choice for effect in chosen for choice in _list_choices(effect, model, proposals)]
    resolvable = [choice for choice in choices if resolved is None or is_resolved(choice, model.robot, resolved)]
    changed = [
        choice for effect in chosen if effect.may_change for choice in list_change_candidates(effect, model, proposals)
    ]
    known = [candidate.choice for candidate in earlier.candidates] if earlier else []
    pool = build_pool_of_choices(model, list(dict.fromkeys([*known, *refined, *resolvable, *changed])), earlier=earlier)
    # A line that stands out clearly is a candidate from the start, even if it is among the faint ones as well.
    faint = _select_waves(pool, chosen, model, proposals.angle_lines.faint)
    clear = _select_waves(pool, chosen, model, proposals.angle_lines.clear)
    return replace(pool, since=proposals.since, faint=faint - clear, largest=proposals.largest)


def _select_waves(
    pool: Pool, effects: Sequence[Effect], model: Model, lines: Sequence[tuple[int, float]]
) -> frozenset[Candidate]:
    """Return the candidates that are waves over a joint's angle at these lines."""
    waves = {choice for effect in effects for choice in _list_waves(effect, model, lines)}
    return frozenset(candidate for candidate in pool.candidates if candidate.choice in waves)


def _list_waves(effect: Effect, model: Model, lines: Sequence[tuple[int, float]]) -> list[EffectChoice]:
    """Return the choices of an effect that is a wave over a joint's angle, at lines (joint index, waves per turn)."""
    if effect.proposal != "angle_spectrum":
        return []
    spec, joints = effect.shapes[0], model.robot.joint_names
    waves = dict.fromkeys((j, wave) for j, k in lines for wave in spec.list_allowed_values(k))
    return [EffectChoice(effect.id, (joints[j],), ((spec.name, wave),)) for j, wave in waves]


def build_pool_of_choices(
    model: Model,
    choices: Sequence[EffectChoice],
    beside: Sequence[Column] = (),
    earlier: Pool | None = None,
) -> Pool:
    """Build the pool of a model and these choices; what the model has already, or is zero, is no candidate.

    Parameters
    ----------
    model : Model
        The model in question.
    choices : sequence of EffectChoice
        What may be missing.
    beside : sequence of Column
        Columns that stand for the model where they are not those that it keeps.
    earlier : Pool, optional
        A pool of the first of these choices, whose compiled columns are shared.

    Returns
    -------
    Pool
        The pool.
    """
    signals = model.signals
    columns: list[Column] = list(beside or model.kept)
    n_base = len(columns)
    candidates: list[Candidate] = []
    # Columns that several choices share are evaluated once.
    index = {column.key: k for k, column in enumerate(columns)}

    seen: set[tuple[int, ...]] = set()
    for choice in choices:
        numbers = []
        for column in build_columns([choice], signals):
            if not column.torque.nnz():
                continue
            if column.key not in index:
                index[column.key] = len(columns)
                columns.append(column)
            numbers.append(index[column.key])
        fresh = tuple(k for k in numbers if k >= n_base)
        # Choices may differ in name and have the same columns: the first stands for all of them.
        if fresh and fresh not in seen:
            seen.add(fresh)
            candidates.append(Candidate(choice.effect, choice.joints, choice.shape, fresh, choice.runs))
    # What the model has is compiled already.
    compiled = earlier.observation if earlier else model.observation
    return Pool(compiled.extend(columns[compiled.n_columns :], signals), n_base, tuple(candidates))


def select_columns_on(pool: Pool, candidate: Candidate, joint: str) -> tuple[int, ...]:
    """Return the columns of a candidate that are of one joint."""
    return tuple(k for k in candidate.columns if pool.observation.columns[k].link == joint)


def _list_choices(effect: Effect, model: Model, leads: ShapeProposals) -> list[EffectChoice]:
    robot = model.robot.tree
    possible = find_places(effect, model.robot)
    if not possible or (effect.needs_temperature and not leads.has_temperature):
        return []
    # Effects of a whole session, such as warming up, need a session long enough to show them.
    if effect.needs_session and leads.session < _SHORTEST_SESSION:
        return []
    if effect.in_some_runs:
        # The last link, and those on which it would explain most.
        last = [robot.joint_names[j] for j in effect.get_default_joints(robot)]
        places = [(runs, name) for runs in leads.run_groups for name in (*last, *leads.carriers.get(runs, ()))]
        return [EffectChoice(effect.id, (name,), (), runs) for runs, name in dict.fromkeys(places)]
    if effect.scope == "robot":
        return _list_robot_choices(effect, model, leads)
    # What the model has on a joint is not missing there.
    free = [j for j in possible if not _is_in_model(effect, model, robot.joint_names[j])]
    if effect.proposal == "angle_spectrum":
        waves = _list_waves(effect, model, leads.angle_lines.clear + leads.angle_lines.faint)
        return [choice for choice in waves if robot.joint_names.index(choice.joints[0]) in free]
    choices = [
        EffectChoice(effect.id, (robot.joint_names[j],), _sort_shape(shape))
        for j in free
        for shape in effect.grid(robot, j)
    ]
    if effect.is_friction and len(free) > 1:
        choices += _list_groups(effect, model, free)
    return choices


def list_change_candidates(effect: Effect, model: Model, leads: ShapeProposals) -> list[EffectChoice]:
    """List the choices of an effect in the later runs alone: what it is more, or less, than before.

    Friction of all joints together is asked about where no temperature can say that they were warm.

    Parameters
    ----------
    effect : Effect
        The effect.
    model : Model
        The model in which something is missing.
    leads : ShapeProposals
        Labels of the later runs, and whether there are temperatures.
    """
    robot, since = model.robot.tree, leads.since
    possible = find_places(effect, model.robot)
    if not since or not possible:
        return []
    if effect.scope == "robot":
        return [EffectChoice(effect.id, (), _sort_shape(shape), since) for shape in effect.grid(robot, 0)]
    choices = [
        EffectChoice(effect.id, (robot.joint_names[j],), _sort_shape(shape), since)
        for j in possible
        for shape in effect.grid(robot, j)
    ]
    if effect.shown_by:
        choices = [choice for choice in choices if _acts_visibly(effect, choice, model)]
    if effect.is_friction and len(possible) > 1 and not leads.has_temperature:
        choices += [replace(choice, runs=since) for choice in _list_groups(effect, model, list(possible))]
    return choices


def _acts_visibly(effect: Effect, choice: EffectChoice, model: Model) -> bool:
    columns = build_columns([choice], model.signals)
    return any(column.torque.nnz() and column.parameter in effect.shown_by for column in columns)


def _list_robot_choices(effect: Effect, model: Model, leads: ShapeProposals) -> list[EffectChoice]:
    """List the choices of an effect that belongs to the whole robot."""
    # Each burst is tried as a disturbance of just that time.
    if effect.proposal == "burst":
        return [
            EffectChoice(effect.id, (), _sort_shape({"t0": start, "t1": end}), (run,))
            for run, start, end in leads.bursts
        ]
    if any(choice.effect == effect.id for choice in model.effects) and effect.proposal == "grid":
        return []
    if effect.proposal == "time_spectrum":
        # What shakes goes on from run to run, but a clock that starts anew in each loses its phase.
        shapes = [((effect.shapes[0].name, line),) for line in leads.time_lines]
        return [EffectChoice(effect.id, (), shape, runs) for shape in shapes for runs in ((), *leads.single_runs)]
    return [EffectChoice(effect.id, (), _sort_shape(shape)) for shape in effect.grid(model.robot, 0)]


def is_resolved(choice: EffectChoice, robot: Robot, resolved: Resolution) -> bool:
    """Return whether a choice's shape constants are large enough to be seen in the data."""
    joints = [j for name in choice.joints for j in robot.get_movers(name)]
    specs = CATALOGUE[choice.effect].shapes
    return all(resolved.is_resolved(spec, choice.shape_values.get(spec.name, spec.default), joints) for spec in specs)


def is_width_resolved(choice: EffectChoice, robot: Robot, resolved: Resolution) -> bool:
    """Return the same for constants that are a speed, or a travel since a halt, alone.

    A slip distance at the limit of resolution is still hysteresis, only sharper than the data can tell; a friction
    peak narrower than the limit is nothing that was seen. A refined constant may be half a step of the grid below.
    """
    joints = [j for name in choice.joints for j in robot.get_movers(name)]
    specs = [spec for spec in CATALOGUE[choice.effect].shapes if spec.resolved_by in ("speed", "travel")]
    values = [choice.shape_values.get(spec.name, spec.default) for spec in specs]
    return all(resolved.is_resolved(s, v, joints, _HALF_A_STEP) for s, v in zip(specs, values, strict=True))


def is_sharper_than_resolved(choice: EffectChoice, robot: Robot, resolved: Resolution) -> bool:
    """Return whether a choice's slip distance is at the limit of resolution: how it slips within is not seen."""
    joints = [j for name in choice.joints for j in robot.get_movers(name)]
    slips = [spec for spec in CATALOGUE[choice.effect].shapes if spec.resolved_by == "displacement"]
    values = [choice.shape_values.get(spec.name, spec.default) for spec in slips]
    return any(not resolved.is_resolved(s, v, joints, 1.0 / _HALF_A_STEP) for s, v in zip(slips, values, strict=True))


def find_places(effect: Effect, robot: Robot) -> tuple[int, ...]:
    """Return the joints of the tree that an effect is tried on; on those that follow others it is friction alone.

    A joint that turns so many times as far as a driven one has the same friction for all that can be seen.

    Parameters
    ----------
    effect : Effect
        The effect.
    robot : Robot
        The robot.
    """
    possible, linkage = list_possible_joints(effect, robot.tree), robot.linkage
    if linkage is None or effect.in_some_runs:
        return possible
    rubs = effect.is_friction and effect.sits_on != "motor"
    return tuple(j for j in possible if j in linkage.driven or (rubs and not linkage.follows_one_driven_joint(j)))


def _list_groups(effect: Effect, model: Model, free: list[int]) -> list[EffectChoice]:
    """List the choices of one friction effect on all joints at once, with shape constants common to all of them."""
    robot = model.robot.tree
    if any(spec.relative_to_velocity for spec in effect.shapes):
        velocities = {robot.joints[j].limits.velocity for j in free}
        if len(velocities) > 1:
            # A shape that is relative to each joint's own velocity is not one shape constant.
            slowest = min(free, key=lambda j: robot.joints[j].limits.velocity or 0.0)
            grid = effect.grid(robot, slowest)
        else:
            grid = effect.grid(robot, free[0])
    else:
        grid = effect.grid(robot, free[0])
    names = tuple(robot.joint_names[j] for j in free)
    return [EffectChoice(effect.id, names, _sort_shape(shape)) for shape in grid]


def explain_absence(effect: Effect, joint: str, model: Model, leads: ShapeProposals) -> str:
    """Return why an effect is no candidate on a joint, in words; the joint is empty for one of the whole robot."""
    if _is_in_model(effect, model, joint):
        return "the model contains it"
    names = model.robot.tree.joint_names
    if effect.scope == "joint" and joint not in {names[j] for j in find_places(effect, model.robot)}:
        return "it cannot act on this joint"
    if effect.needs_temperature and not leads.has_temperature:
        return "the recordings have no temperature"
    if effect.needs_session and leads.session < _SHORTEST_SESSION:
        return f"the recordings span less than {_SHORTEST_SESSION:.0f} s of one clock"
    if effect.in_some_runs:
        return "there are no separate runs of which some could have it" if not leads.run_groups else _OTHER_LINK
    if effect.proposal == "angle_spectrum":
        return "no line stands out in the residual over the angle of this joint"
    if effect.proposal == "time_spectrum":
        return "no line stands out in the residual over time"
    if effect.is_transient:
        return "no span of time stands out in the residual"
    return "its torque is zero, equals that of another candidate, or is not resolved by the filtered position"


_OTHER_LINK = "a load of some runs is tried on the last link, and on those links where it would explain most"


def _is_in_model(effect: Effect, model: Model, joint: str) -> bool:
    """Return whether an effect is in the model already on a joint (a second line may be missing beside a first)."""
    if effect.proposal == "angle_spectrum":
        return False
    return any(c.effect == effect.id and (not c.joints or joint in c.joints) for c in model.effects)


def _sort_shape(shape: Mapping[str, float]) -> tuple[tuple[str, float], ...]:
    return tuple(sorted((name, float(value)) for name, value in shape.items()))
