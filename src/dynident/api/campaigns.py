"""`dynident.Campaign`: ask for the next motion, tell its recording, until enough is known."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from dynident.advice.campaign import CampaignState, PlannedRun, add_run, plan_run, start_campaign
from dynident.advice.campaign_request import CampaignRequest, Decision
from dynident.advice.payload_goal import has_load, name_as_loaded
from dynident.api.argument_checks import check_arguments, require
from dynident.api.effect_arguments import check_effects, resolve_effects
from dynident.api.figure import Figure, join_figures
from dynident.api.model import NO_RECORDINGS, Model
from dynident.api.motion_design import DesignedMotion
from dynident.api.named_tables import Framed, Table, build_columns
from dynident.api.recording_collection import CheckedRecording, Recordings, SomeRecordings, as_recordings
from dynident.api.recording_files import read_recordings
from dynident.api.recordings_in_memory import RecordingData
from dynident.diagnosis.comparison.measured_against_predicted import compare as compare_recording
from dynident.diagnosis.comparison.measured_against_predicted import find_contacts
from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.excitation.criteria.prediction_region import collect_region
from dynident.identification.robot_recording_import import build_recorded_joints
from dynident.number_format import format_count
from dynident.presentation.design_tables import build_campaign_table
from dynident.presentation.tables import ReportedTable
from dynident.progress import Progress, ignore_progress
from dynident.recordings import RecordingError, StopReason, find_stop_reasons, list_fatal_findings
from dynident.robot import Robot
from dynident.text_and_html_tables import join_html, render_paragraph


class Campaign(Framed):
    """A sequence of runs that ends when torque, parameters, effects or a payload are known as accurately as requested.

    `ask` designs the next motion and predicts the error that it will leave. `tell` takes its recording, identifies and
    diagnoses the model from all runs, adds the effects that the diagnosis recommends, and decides whether another run
    is needed.

    `to_frame` has a row for each run: run (its name), minutes (robot time so far, min), promised, predicted,
    parameters, lacking and error (fractions, of the worst joint; missing if there is none), added (effects that the
    campaign added to the model).

    Parameters
    ----------
    robot : Robot
        The robot; all motions keep its limits.
    error : float, optional
        Largest relative error of the predicted torque that is allowed for each joint, with 95 % probability; 0.05 is
        5 %.
    minutes : float, optional
        Robot time of all runs together.
    region : recordings, optional
        Recordings of the application, for whose motions the torque is to be predicted. By default, all states within
        the limits, up to half of the speeds.
    effects : texts or choices, optional
        Effects of the first model.
    duration : float, optional
        Longest time of a run without the moves from and to home, in s; a run may take half of it or a quarter.
    sampling_rate : float, optional
        Rate of the samples in Hz.
    request : CampaignRequest, optional
        All options, and other goals than torque. The other arguments take precedence over it.

    Examples
    --------
    >>> campaign = dy.Campaign(robot, error=0.03, minutes=5)
    >>> while not campaign.decision.is_end:  # doctest: +SKIP
    ...     campaign.ask().save("motion.csv")
    ...     # move the robot along motion.csv and record it
    ...     campaign.tell(dy.read_recordings("run.csv", robot=robot))
    >>> campaign.decision.code
    'next_run'
    """

    @check_arguments
    def __init__(
        self,
        robot: Robot,
        *,
        error: float | None = None,
        minutes: float | None = None,
        region: SomeRecordings = (),
        effects: str | EffectChoice | Iterable[str | EffectChoice] | None = None,
        duration: float | None = None,
        sampling_rate: float | None = None,
        request: CampaignRequest | None = None,
    ) -> None:
        campaign_request = request or CampaignRequest()
        if error is not None:
            campaign_request = replace(campaign_request, error=error)
        if minutes is not None:
            campaign_request = replace(campaign_request, minutes=minutes)
        if effects is not None:
            chosen = check_effects(resolve_effects(effects), robot)
            campaign_request = replace(campaign_request, choices=replace(campaign_request.choices, effects=chosen))
        trajectory = campaign_request.design.trajectory
        if duration is not None:
            trajectory = replace(trajectory, duration=duration)
        if sampling_rate is not None:
            trajectory = replace(trajectory, sampling_rate=sampling_rate)
        campaign_request = replace(campaign_request, design=replace(campaign_request.design, trajectory=trajectory))
        motions = as_recordings(region).recordings
        self._state = start_campaign(robot, campaign_request, collect_region(motions) if motions else None)
        self._planned: PlannedRun | None = None
        self._recordings = NO_RECORDINGS

    @property
    def state(self) -> CampaignState:
        """The campaign as the library has it."""
        return self._state

    @property
    def decision(self) -> Decision:
        """What to do next, and why; `decision.is_end` tells whether the campaign is over."""
        return self._state.decision

    @property
    def model(self) -> Model:
        """The model from all runs so far.

        Raises
        ------
        DynidentError
            Before the first run.
        """
        if self._state.identification is None:
            raise DynidentError(
                "there is no model before the first run: give its recording to tell(…)", title="No run yet"
            )
        return Model(self._state.identification, self._recordings)

    @property
    def promise(self) -> dict[str, float] | None:
        """Relative error of each joint or parameter that the last motion promises; None where nothing is promised."""
        if self._planned is None or self._planned.promised is None:
            return None
        return dict(zip(self._state.targets, map(float, self._planned.promised), strict=True))

    def ask(self, *, progress: Progress = ignore_progress) -> DesignedMotion:
        """Design the next motion.

        Parameters
        ----------
        progress : function, optional
            Called with the fraction done and a message.

        Returns
        -------
        DesignedMotion
            The motion from rest to rest. The first is slow, since nothing is known of the torque yet.

        Raises
        ------
        DynidentError
            Where the campaign is over, or no motion keeps the limits.
        """
        if self.decision.is_end:
            raise DynidentError(f"the campaign is over: {self.decision.sentence}", title="Campaign over")
        # Asked twice, the same motion: a search of several seconds is not made again.
        if self._planned is None:
            self._planned = plan_run(self._state, progress)
        return DesignedMotion(self._state.robot, self._planned.design)

    def tell(self, recording: SomeRecordings, *, progress: Progress = ignore_progress) -> Decision:
        """Take in the recording of a run, of the motion asked for or of any other.

        Parameters
        ----------
        recording : recording
            One recording, as `read_recordings` gives it.
        progress : function, optional
            Called with the fraction done and a message.

        Returns
        -------
        Decision
            What to do next, and why.

        Raises
        ------
        DynidentError
            For another number of recordings, one that was added before, or one that no model can be identified from.
        """
        checked = as_recordings(recording)
        require(len(checked) == 1, checked, "recording", "give the one recording of this run")
        self._state = add_run(self._state, checked.recordings[0], self._planned, progress)
        # The campaign gives a recording a name of its own where another run has it already.
        named = replace(next(iter(checked)), recording=self._state.recordings[-1])
        self._recordings = Recordings((*self._recordings, named))
        self._planned = None
        return self.decision

    def check_under_way(self, rows: RecordingData) -> tuple[StopReason, ...]:
        """Check the run that is under way, for a program that stops the robot where it is not worth going on with.

        Parameters
        ----------
        rows : path, data frame or mapping of arrays
            The rows so far, as `read_recordings` takes them.

        Returns
        -------
        tuple of StopReason
            What no further second heals: saturated torques, wrong signs or orders, limits that are exceeded, half of
            the planned speed or less, and torque that the model of the runs before does not explain by far (contact).
        """
        robot = self._state.robot
        return find_faults_under_way(self._state, self._planned, lambda: read_recordings(rows, robot=robot)[0])

    def plot(self) -> Figure:
        """Draw the errors over robot time: promised, reached, and the goal.

        Returns
        -------
        Figure
            One panel.

        Raises
        ------
        DynidentError
            Before the first run.
        """
        from dynident.reports.figures.design import draw_campaign

        if not self._state.runs:
            raise DynidentError("there is nothing to draw before the first run", title="No run yet")
        return join_figures([draw_campaign(self._state)], f"campaign with {self._state.robot.name}")

    def _columns(self) -> Table:
        minutes = np.cumsum([run.seconds for run in self._state.runs]) / 60.0
        rows = [
            (
                run.name,
                float(time),
                *(None if part is None else float(part.max()) for part in (run.promised, run.predicted)),
                float(run.parameters.max()),
                float(run.lacking.max()),
                float(run.errors.max()),
                ", ".join(choice.effect for choice in run.added),
            )
            for run, time in zip(self._state.runs, minutes, strict=True)
        ]
        return build_columns(
            ("run", "minutes", "promised", "predicted", "parameters", "lacking", "error", "added"), rows
        )

    def _build_table(self) -> ReportedTable:
        state = self._state
        return build_campaign_table(state.runs, state.request, state.robot.joint_names)

    def __repr__(self) -> str:
        table = self._build_table()
        runs = format_count(len(self._state.runs), "run")
        head = f"Campaign({self._state.robot.name}, {runs}): {self.decision.sentence}"
        return table.to_text(head) if self._state.runs else head

    def _repr_html_(self) -> str:
        table = self._build_table()
        shown = (table.to_html(), *map(render_paragraph, table.notes)) if self._state.runs else ()
        return join_html(render_paragraph(self.decision.sentence, strong=True), *shown)


def find_faults_under_way(
    state: CampaignState, planned: PlannedRun | None, read_rows: Callable[[], CheckedRecording]
) -> tuple[StopReason, ...]:
    """Return why the run under way is to be stopped; see `Campaign.check_under_way`.

    Parameters
    ----------
    state : CampaignState
        The campaign before the run.
    planned : PlannedRun, optional
        The motion that is made.
    read_rows : function
        Reads the rows so far, as the recording of the run will be read.
    """
    try:
        checked = read_rows()
    except RecordingError as error:
        # What the first seconds lack (no joint has moved yet) is no reason to stop.
        return tuple(list_fatal_findings(error.checks))
    limits = build_recorded_joints(state.robot).known_limits
    motion = None if planned is None else (planned.design.t, planned.design.q)
    reasons = find_stop_reasons(checked.recording, checked.checks, limits, motion)
    model = state.identification
    # A load that is mounted for the first time is nothing that the model can know of.
    if model is None or (state.is_load_due and not has_load(model.model.effects)):
        return reasons
    try:
        recording = checked.recording
        tested = name_as_loaded(recording, state.recordings) if state.is_load_due else recording
        comparison = compare_recording(model, tested)
    except DynidentError:
        # Shorter than the filters are long.
        return reasons
    return (*reasons, *find_contacts(comparison, limits))


@check_arguments
def run_campaign(
    campaign: Campaign,
    execute: Callable[[DesignedMotion], SomeRecordings],
    *,
    progress: Progress = ignore_progress,
) -> Campaign:
    """Run a campaign to its end.

    Parameters
    ----------
    campaign : Campaign
        The campaign, new or with runs.
    execute : function
        Moves the robot along a motion and returns the recording. With the goal payload, it has to wait for the load
        before the first motion where `campaign.state.is_load_due`.
    progress : function, optional
        Called with the fraction done and a message.

    Returns
    -------
    Campaign
        The same campaign, at its end.

    Examples
    --------
    >>> def record(motion):  # moves the robot along the motion, and records it
    ...     motion.save("motion.csv")
    ...     return dy.read_recordings("run.csv", robot=robot)
    >>> campaign = dy.run_campaign(dy.Campaign(robot, error=0.03), record)  # doctest: +SKIP
    """
    while not campaign.decision.is_end:
        campaign.tell(execute(campaign.ask(progress=progress)), progress=progress)
    return campaign
