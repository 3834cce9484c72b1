"""`dynident.design`: design an exciting trajectory, show it, save it as CSV, Parquet, YAML or JSON."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from dynident.advice import AdvisedDiagnosis
from dynident.api.argument_checks import check_arguments
from dynident.api.effect_arguments import check_effects, resolve_effects
from dynident.api.figure import Figure, join_figures
from dynident.api.model import Model
from dynident.api.model_diagnosis import DiagnosedModel
from dynident.api.motion_arguments import resolve_simulation
from dynident.api.named_tables import Framed, PlainText, Table, build_columns
from dynident.api.recording_collection import Recordings, SomeRecordings, as_recordings
from dynident.api.recording_files import read_recordings
from dynident.effects import EffectChoice
from dynident.errors import DynidentError, word_notes, write_argument
from dynident.excitation import Design, DesignRequest, design_experiment, write_design
from dynident.excitation.design_files import design_table
from dynident.excitation.design_request import Kind
from dynident.excitation.standing_feet import stand_on_feet
from dynident.file_output import check_ending
from dynident.presentation.design_tables import LIMITS_COLUMNS, build_limits_table, describe_design
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.recordings import RecordingMetadata
from dynident.recordings.arrow_tables import table_column_to_numbers
from dynident.recordings.row_storage import list_signal_units
from dynident.robot import Robot
from dynident.text_and_html_tables import join_html, render_details, render_list, render_paragraph

if TYPE_CHECKING:
    from dynident.simulation import Simulated

TRAJECTORY_ENDINGS = (".csv", ".parquet", ".yaml")
_SHOWN_MARGINS = 5


@dataclass(frozen=True, eq=False)
class DesignedMotion(Framed):
    """A trajectory within the robot's limits.

    `to_frame` has a row for each sample, from home to home, as `save` writes them: t (s), q_<joint> (rad, m where it
    slides), dq_<joint> (rad/s, m/s), ddq_<joint> (rad/s^2, m/s^2); of a set of test motions also segment, the number of
    the motion from 1 on, 0 between them.

    Parameters
    ----------
    robot : Robot
        The robot that shall make the motion; where it stands on feet, as these hold it.
    design : Design
        The design as the library gives it.
    """

    robot: Robot
    design: Design

    def __post_init__(self) -> None:
        object.__setattr__(self, "robot", stand_on_feet(self.robot, self.design.request)[0])

    @property
    def summary(self) -> PlainText:
        """The quality of the design, in a few sentences: `motion.summary` or `motion.summary()`."""
        return PlainText(describe_design(self.design))

    @property
    def condition_number(self) -> float:
        """Condition number of W, [12.12], of the parameters in their SI units; `Model.condition_number` is the same."""
        return self.design.criterion_values.condition_number

    @property
    def scaled_condition_number(self) -> float:
        """Condition number of W with columns of equal size, which has no units; as that of a `Model`."""
        return self.design.criterion_values.scaled_condition_number

    @property
    def limits(self) -> Table:
        """How near the motion comes to each limit, the nearest first: joint, limit, reached, allowed, used.

        `used` is the used part of the room, where 1 touches the limit; a position is counted from the middle of its
        range. Values are in SI units.
        """
        margins = sorted(self.design.margins, key=lambda margin: -margin.share)
        rows = [(margin.joint, margin.limit, margin.value, margin.bound, margin.share) for margin in margins]
        return build_columns(LIMITS_COLUMNS, rows)

    def save(self, path: str | Path, speed: float = 1.0) -> None:
        """Write the trajectory: t, q_<joint>…, dq_<joint>…, ddq_<joint>… as .csv or .parquet, or .yaml for ROS 2.

        Parameters
        ----------
        path : path
            The file to write; its ending decides on the format.
        speed : float
            Share of the designed speed: 1/3 for a first run on the robot. The rows are the same; t, velocities and
            accelerations are scaled.

        Raises
        ------
        DynidentError
            For another ending, a folder that does not exist, or a speed that is no share.
        """
        write_design(self.design, check_ending(path, TRAJECTORY_ENDINGS), speed)

    def simulate(
        self,
        parameters: Mapping[str, float] | None = None,
        *,
        request: Simulated | None = None,
        name: str = "simulated",
        progress: Progress = ignore_progress,
    ) -> Recordings:
        """Simulate the motion on a virtual robot, and return what its sensors record.

        Parameters
        ----------
        parameters : mapping of str to float, optional
            True standard parameters by name, such as {"Fc1": 3.0, "Fv1": 2.0}, in SI units. Links have those of the
            description and joints the usual friction and rotor inertia where none is given.
        request : dynident.simulation.Simulated, optional
            Further effects, noise of the sensors, number of runs and seed.
        name : str
            Name of the recording.
        progress : function, optional
            Called with the fraction done and a message.

        Returns
        -------
        Recordings
            One recording; `Model.true_params` has the parameters that it was made with.

        Raises
        ------
        DynidentError
            For a parameter that the robot does not have, a motion that it cannot follow, or one whose trunk sways.

        Examples
        --------
        >>> run = motion.simulate({"Fc1": 3.0})  # doctest: +SKIP
        >>> model = dy.identify(motion.robot, run)  # doctest: +SKIP
        >>> model.params["Fc1"], model.true_params({"Fc1": 3.0})["Fc1"]  # doctest: +SKIP
        """
        from dynident.simulation import build_recording_table, simulate

        self.design.request.standing.refuse_simulation()
        simulation = resolve_simulation(self.robot, parameters, request, self.design)
        table = build_recording_table(simulate(self.robot, simulation, scale_progress(progress, 0.0, 0.9)))
        metadata = RecordingMetadata(name=name)
        return read_recordings(table, robot=self.robot, metadata=metadata, progress=scale_progress(progress, 0.9, 1.0))

    def _columns(self) -> Table:
        # The same table that `save` writes, so that a frame and a file have the same columns.
        table = design_table(self.design)
        columns = {name: table_column_to_numbers(table.column(name)) for name in table.column_names}
        units = list_signal_units(columns, self.design.joint_names, [joint.kind for joint in self.robot.joints])
        return Table(columns, units)

    def plot(self) -> Figure:
        """Draw the joints within their limits, their velocity over position, and the path of the tool.

        Returns
        -------
        Figure
            Positions, velocities and accelerations as shares of their limits in the upper row; velocity over position
            and the path of the tool in the lower one.
        """
        from dynident.reports.figures.design import draw_design

        return join_figures([draw_design(self.design, self.robot)], f"designed motion of {self.robot.name}")

    def __repr__(self) -> str:
        return f"DesignedMotion({self.robot.name}): {self.summary}"

    def _repr_html_(self) -> str:
        notes = word_notes(self.design.notes, write_argument)
        return join_html(
            render_paragraph(f"Motion of {self.robot.name}", strong=True),
            render_paragraph(self.summary),
            build_limits_table(self.robot, self.design.margins, _SHOWN_MARGINS).to_html(),
            render_details("notes", render_list(notes)) if notes else "",
        )


@check_arguments
def design(
    robot: Robot | Model,
    request: DesignRequest | DiagnosedModel | None = None,
    *,
    kind: Kind | None = None,
    effects: str | EffectChoice | Iterable[str | EffectChoice] | None = None,
    duration: float | None = None,
    sampling_rate: float | None = None,
    earlier: SomeRecordings = (),
    progress: Progress = ignore_progress,
) -> DesignedMotion:
    """Design a motion that excites the parameters, within the robot's limits and without collision.

    Parameters
    ----------
    robot : Robot or Model
        The robot that will execute the motion, with its limits; or its identified model. A model predicts the torque
        with friction and rotors, and with a margin for the uncertainty. For a robot, the torque is predicted by the
        model of the diagnosis if `request` is one, otherwise by the inertias of the description alone.
    request : DesignRequest or diagnosis, optional
        All options: criterion, limits, surroundings, time, seed and, in its `trajectory`, the family of motions. If a
        diagnosis is given, its next experiment is designed. The other arguments take precedence over it.
    kind : str, optional
        "optimized" (the default), "random", "sequential", "constant_velocity", "slow_sweep", "reversals".
    effects : texts or choices, optional
        Effects to be identified, such as ["default", "offset"].
    duration : float, optional
        Length of one period in s.
    sampling_rate : float, optional
        Rate of the samples in Hz.
    earlier : recordings
        Recordings that the motion complements: they are part of the data of the design.
    progress : function, optional
        Called with the fraction done and a message.

    Returns
    -------
    DesignedMotion
        The motion from rest to rest, and its quality.

    Raises
    ------
    DynidentError
        If no motion keeps the limits; the message names the limit.

    Examples
    --------
    >>> motion = dy.design(robot, kind="random", duration=5.0, sampling_rate=100.0)
    >>> motion.design.q.shape[1] == robot.n
    True
    >>> motion.save("motion.csv")
    """
    machine = robot.robot if isinstance(robot, Model) else robot
    # The arguments of their own replace fields of the request one by one, so that the rest of it stays.
    design_request = resolve_request(request)
    if kind is not None:
        design_request = replace(design_request, kind=kind)
    if effects is not None:
        design_request = replace(design_request, effects=check_effects(resolve_effects(effects), machine))
    if duration is not None:
        design_request = replace(design_request, trajectory=replace(design_request.trajectory, duration=duration))
    if sampling_rate is not None:
        design_request = replace(
            design_request, trajectory=replace(design_request.trajectory, sampling_rate=sampling_rate)
        )
    model = robot if isinstance(robot, Model) else request.model if isinstance(request, DiagnosedModel) else None
    designed = design_experiment(
        machine,
        design_request,
        progress,
        as_recordings(earlier).recordings,
        identified=None if model is None else model.identification.estimate,
    )
    return DesignedMotion(machine, designed)


def resolve_request(request: DesignRequest | DiagnosedModel | AdvisedDiagnosis | None) -> DesignRequest:
    """Return the request that a function was given, or that a diagnosis proposes.

    Parameters
    ----------
    request : DesignRequest, DiagnosedModel or AdvisedDiagnosis, optional
        None for all defaults.

    Returns
    -------
    DesignRequest
        The request; of a diagnosis that of its next experiment.

    Raises
    ------
    DynidentError
        For a diagnosis that proposes no experiment.
    """
    if isinstance(request, DesignRequest):
        return request
    if request is None:
        return DesignRequest()
    if request.next_experiment is None:
        raise DynidentError(
            "the diagnosis proposes no experiment, because no question is open", title="Nothing to design"
        )
    # The diagnosis proposes a whole request, so that its family of motions fits the question that it leaves open.
    return request.next_experiment.design
