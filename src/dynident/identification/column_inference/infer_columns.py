"""`propose`: from a sample of a file to proposed metadata; runs the other modules here in their order."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import Remedy
from dynident.identification.column_inference import dynamics_fits
from dynident.identification.column_inference import unit_inference as of_units
from dynident.identification.column_inference.column_groups import (
    ColumnGroup,
    ask_for_missing_joints,
    find_torque_of_most_joints,
    group_columns,
    group_few_joints,
    select_axes_in_use,
)
from dynident.identification.column_inference.column_statistics import (
    Clock,
    Sample,
    ask_for_other_rate,
    drop_empty_rows,
    find_changing_columns,
    find_clock_columns,
    find_converter_zero,
    guess_servo_units,
    mask_outliers,
    restore_masked,
)
from dynident.identification.column_inference.metadata_proposal import (
    COMMANDED_RANK,
    NO_MASSES,
    Guess,
    Proposal,
    Question,
    ask_for_unit_of_time,
    ask_to_lock_still_joints,
    ask_to_unwrap,
    describe_constant_columns,
    describe_further_joints,
    describe_gear_ratios,
    describe_single_joint,
    describe_still_joints,
    describe_unknown_signals,
    describe_unused_columns,
    describe_waves,
    name_further_efforts,
    read_effort_kind,
    report_silent_torques,
)
from dynident.identification.column_inference.proposal_in_progress import WorkingProposal
from dynident.identification.column_inference.time_and_pose_columns import (
    TOGETHER,
    add_base_columns,
    are_columns_poses,
    ask_about_file,
    ask_about_length,
    ask_about_time,
    drop_dependent_questions,
    find_segment_column,
    guess_clock,
    guess_clock_of_poses,
    guess_efforts_at_poses,
    report_empty_columns,
)
from dynident.identification.column_inference.torque_or_current import (
    NO_MEASUREMENT,
    ask_for_gains,
    classify_effort,
    fit_torque_unit,
)
from dynident.identification.column_inference.unnamed_columns import (
    find_forces,
    find_plainest_group,
    group_other_names,
    group_unnamed_columns,
    hold_same_values,
)
from dynident.recordings.columns_to_signals import NOT_RECORDED
from dynident.recordings.recording_metadata import EffortKind
from dynident.recordings.signal_spectra import SLOPE, correlate_slopes, fill_gaps
from dynident.recordings.units import MOMENTS, find_common_ratio, find_conversion
from dynident.robot import Robot
from dynident.robot.description_and_json import list_described_joints, set_base
from dynident.robot.pseudo_inertia import find_description_units

_FEWEST_ROWS = 3
"""Rows with a time, below which that column is not the time."""
_NOTHING, _EFFORTS = 1e-30, ("tau", "current", "effort")
"""Efforts that are smaller in any unit are no efforts; what columns of them may be."""


def propose(sample: Sample, robot: Robot) -> Proposal:
    """Guess what the columns are. Where that is not sure, the proposal has questions.

    Parameters
    ----------
    sample : Sample
        Consecutive rows of the file.
    robot : Robot
        The robot.

    Returns
    -------
    Proposal
        Columns and units, with guesses and questions.
    """
    # Masses in grams would make every torque look wrong; the description is read in SI units first.
    units = find_description_units(robot)
    machine = robot if units is None else units.to_si(robot)
    if not robot.n_base:
        return _ColumnInference(sample, machine, robot).run()
    # The joints are those of the same robot on a fixed base.
    return _ColumnInference(sample, set_base(machine, "fixed"), robot, moving_base=robot).run()


@dataclass
class _ColumnInference(WorkingProposal):
    """A proposal in the making: the steps from names and data to columns, units and the kind of effort."""

    moving_base: Robot | None = None
    clock: Clock | None = None

    def run(self) -> Proposal:
        """Guess time, groups of columns, positions, efforts and units, in this order."""
        times = [index for index, name in enumerate(self.column_names) if name.signal == "t"]
        whole = drop_empty_rows(self.sample, times)
        sample = self.sample = mask_outliers(whole, times)
        self.of_poses = are_columns_poses(self)
        self.alive = find_changing_columns(sample.values)
        kind: EffortKind = "unknown"
        self.guesses += [Guess("rows", "joined", 0.95, remark) for remark in self.sample.remarks]
        report_empty_columns(self)
        if self.robot.inertias is None or not self.robot.inertias.any():
            self.add_guess("robot", "no masses", 0.9, NO_MASSES)
        if ask_about_file(self):
            return self._finish(kind)
        # Everything else needs the time: slopes, filters and fits.
        clock = guess_clock_of_poses(self) if self.of_poses else guess_clock(self)
        if clock is None:
            return self._finish(kind)
        self.clock = clock
        self.questions += ask_for_other_rate(sample, clock)
        self.t = sample.values[:, clock.column] * clock.factor
        segment = find_segment_column(self)
        good = np.isfinite(self.t)
        ask_about_length(self, clock)
        if np.count_nonzero(good) < _FEWEST_ROWS:
            self.add_question("columns/t", "Hardly any row has a time: which column is the time?", sample.names)
            return self._finish(kind)
        self.values = fill_gaps(sample.values[good])
        self.t = self.t[good]
        labels = None if segment is None else segment[good]
        # From here on every guess can be tested: right columns let the dynamics explain more of the torque.
        kind_of_fits = dynamics_fits.DynamicsFits if self.moving_base is None else dynamics_fits.NoFits
        kind_of_fits = dynamics_fits.PoseFits if self.of_poses else kind_of_fits
        self.fits = kind_of_fits(self.robot, self.t, labels)
        others = [name for index, name in enumerate(self.column_names) if index != clock.column]
        places = [index for index in range(len(self.column_names)) if index != clock.column]
        followers = () if self.robot.linkage is None else self.robot.linkage.passive
        names = [self.robot.tree.joint_names[j] for j in followers]
        links = [joint.link for joint in self.robot.joints]
        running = set(find_clock_columns(self.values))
        clocks = [place for place, index in enumerate(places) if index in running]
        alive, described = self.alive[places], list_described_joints(self.robot)
        local, rest, following = group_columns(others, self.robot.joint_names, names, alive, links, clocks, described)
        if following:
            unused = ", ".join(others[index].name for index in following)
            self.add_guess("columns", unused, 0.9, "not used: of passive joints, which follow from the driven joints")
        local += group_few_joints(others, rest, self.robot)
        rest = [index for index in rest if not any(index in group.columns for group in local)]
        # The groups were numbered without the time column; number them as the file does.
        groups = [group.renumber(places) for group in local]
        unnamed = [places[index] for index in rest]
        groups += group_other_names(self, groups, unnamed, self._measure_unexplained)
        groups += group_unnamed_columns(self, groups, unnamed, self.alive, self._measure_unexplained)
        position = self._choose_position(groups)
        effort, kind = self._choose_effort(groups, position)
        if position is None or effort is None:
            return self._finish(kind)
        # Registers and empty columns are corrected first, as the import will do it.
        self.read_signs(position, "q")
        self.read_signs(effort, "tau")
        self.mark_unrecorded_torques(effort)
        q = self._convert_positions(position, effort)
        if self.of_poses:
            tau = self.values[:, list(effort.columns)]
            return self._finish(guess_efforts_at_poses(self, self.fits, tau, effort, q, kind))
        if q is not None:
            rows = replace(self.sample, values=restore_masked(self.sample.values, whole.values)[good])
            q, self.fits, put_right = self.condition_rows(self.fits, rows, position, effort, q)
            self.guesses += describe_still_joints(self.robot.joint_names, q)
            self._guess_rates(groups, position, q)
            kind = self._guess_efforts(effort, q, kind)
            motors = [group for group in groups if group.signal == "q" and group.named.motor and group is not position]
            sides = [(self.name_columns(group), self.values[:, list(group.columns)]) for group in (position, *motors)]
            self.guesses += [*put_right, *describe_gear_ratios(self.robot.joint_names, sides)]
        return self._finish(kind)

    def _finish(self, kind: EffortKind) -> Proposal:
        if self.moving_base is not None:
            add_base_columns(self, self.moving_base)
        drop_dependent_questions(self)
        self.questions = name_further_efforts(self.questions, self.further_efforts)
        self._ask_about_guessed_time()
        self.guesses += describe_unused_columns(self.column_names, self.columns, self.robot.n)
        return Proposal(dict(self.columns), dict(self.units), kind, tuple(self.guesses), tuple(self.questions))

    def _measure_unexplained(self, positions: tuple[int, ...], efforts: tuple[int, ...]) -> float:
        """Return the unexplained share of the torque if these columns are it, in rad or degrees, and m or mm."""
        q, tau = self.values[:, list(positions)], self.values[:, list(efforts)]
        slides = np.array([joint.kind == "prismatic" for joint in self.robot.joints])
        lengths = (1.0, 1e-3) if slides.any() else (1.0,)
        factors = [np.where(slides, length, angle) for angle in (1.0, np.pi / 180.0) for length in lengths]
        shares = [self.fits.measure_unexplained(q * factor, tau) for factor in factors]
        return min((share for share in shares if share is not None), default=1.0)

    def _choose_position(self, groups: list[ColumnGroup]) -> ColumnGroup | None:
        # Where there are others, theta is the angle of the motor.
        known = self._list_groups(groups, None, "q")
        if not (candidates := sorted(known, key=lambda group: (group.rank, "theta" in group.named.words))):
            if missing := ask_for_missing_joints(self.column_names, self.robot):
                self.questions.append(missing)
                return None
            detail = "No columns were recognised as the positions of all joints: name them, q1 and so on."
            detail += self._describe_candidates(groups, ("q",), "position")
            self.add_question("columns/q", detail, self.sample.names)
            return None
        equal = [group for group in candidates if group.rank == candidates[0].rank]
        plainest = find_plainest_group(equal)
        candidates = equal = select_axes_in_use([plainest] if plainest else equal, self.values)
        if len(equal) > 1 and not hold_same_values(self.values, equal):
            names = tuple(self.name_columns(group) for group in equal)
            self.add_question("columns/q", "Several sets of columns could be the measured positions: which one?", names)
        elif candidates[0].rank >= 4:
            self.add_question(
                "columns/q", f"{self.name_columns(candidates[0])} are commanded positions: where are the measured ones?"
            )
        self.assign_columns("q", candidates[0])
        self.questions += ask_to_unwrap(self.name_columns(candidates[0]), self.values[:, list(candidates[0].columns)])
        return candidates[0]

    def _choose_effort(
        self, groups: list[ColumnGroup], position: ColumnGroup | None
    ) -> tuple[ColumnGroup | None, EffortKind]:
        if any(question.field == "robot" for question in self.questions):
            return None, "unknown"  # first the user has to say which joints the robot has
        candidates = self._list_groups(groups, position, *_EFFORTS)
        sizes = [np.fmax.reduce(np.abs(self.values[:, list(group.columns)]), axis=None) for group in candidates]
        silent = [group for group, size in zip(candidates, sizes, strict=True) if size < _NOTHING]
        smallest = min((size for size in sizes if size > 0.0), default=0.0)
        candidates = [group for group in candidates if self.alive[list(group.columns)].any() and group not in silent]
        # Torque is preferred to current, as it needs no drive gains.
        candidates.sort(key=lambda group: (group.rank, group.signal != "tau"))
        # What stands in for a torque that no drive wrote: how far the commands are ahead.
        commands = self.find_command(groups, position) if silent and not candidates else []
        if not candidates and silent and not commands:
            self.assign_columns(silent[0].signal or "tau", silent[0])
            # Numbers far below any torque are memory into which nothing was written.
            size = f"below {_NOTHING:g}" if 0.0 < smallest < _NOTHING else "0"
            detail = (
                f"{self.name_columns(silent[0])} are {size} in every row: was the torque not recorded, or did the "
                "robot swing with its motors off? Then only ratios can be identified, inertia and friction over "
                "gravity."
            )
            self.questions.append(Question("effort_kind", detail, ("joint_torque",), "constant_torque"))
            return None, "joint_torque"
        if not candidates:
            slide = all(joint.kind == "prismatic" for joint in self.robot.joints)
            candidates = commands or find_forces(groups, slide=slide) or self._find_torque_of_most_joints(position)
            candidates = candidates or self.find_command(groups, position)
        if commands:
            columns = [self.sample.names[column] for column in silent[0].columns]
            self.guesses.append(report_silent_torques(self.name_columns(silent[0]), columns))
        if not candidates:
            if any(question.field == "robot" for question in self.questions):
                return None, "unknown"
            detail = "No columns were recognised as torques or currents of all joints."
            for still in self._list_groups(groups, position, *_EFFORTS)[:1]:
                detail = describe_constant_columns(self.name_columns(still), self.values[:, list(still.columns)])
            detail += self._describe_candidates(groups, _EFFORTS, "torque")
            self.add_question("columns/tau", detail, self.sample.names)
            return None, "unknown"
        best, *others = candidates
        candidates = [best, *(each for each in others if not hold_same_values(self.values, [best, each], share=0.0))]
        equal = [group for group in candidates[1:] if group.rank == best.rank and group.signal == best.signal]
        if equal and (plain := find_plainest_group([best, *equal])) is not None:
            best, equal = plain, []
        if equal:
            names = tuple(self.name_columns(group) for group in [best, *equal])
            note = " State currents as current1, current2, …" * (best.signal == "effort")
            self.add_question("columns/tau", f"Several sets of columns could be the torque: which one?{note}", names)
        self.further_efforts = [self.name_columns(group) for group in candidates if group is not best]
        if (kind := read_effort_kind(best.signal, best.named, best.rank)) in NO_MEASUREMENT:
            self.refuse_kind(kind, self.name_columns(best))
        elif (question := self._ask_to_lock_fingers(position, best)) is not None:
            self.questions.append(question)
            return None, "unknown"
        return best, kind

    def _list_groups(self, groups: list[ColumnGroup], q: ColumnGroup | None, *signals: str) -> list[ColumnGroup]:
        """Return the groups of signals; of a robot of one joint those of its position's axis, by their numbers."""
        known = [group for group in groups if group.signal in signals and group is not q]
        if q is None or self.robot.n > 1:
            return known
        return [group for group in known if group.named.numbers == q.named.numbers] or known

    def _describe_candidates(self, groups: list[ColumnGroup], signals: tuple[str, ...], name: str) -> str:
        """Say which columns may be a signal that was not recognised, or where else it may be."""
        known = {k for group in groups if group.signal is not None for k in group.columns}
        others = (named for k, named in enumerate(self.column_names) if k not in known)
        further = describe_further_joints(list(others), self.robot.n, signals)
        if further := further or describe_single_joint(self.column_names, self.robot.n, signals):
            return further
        silent = (group for group in groups if group.signal is None and group.rank < COMMANDED_RANK)
        unknown = describe_unknown_signals([self.name_columns(group) for group in silent], name)
        has_rates = name == "position" and any(group.signal == "dq" for group in groups)
        waves = describe_waves(self.column_names) if name == "position" else ""
        detail = f" If they are in another file, {TOGETHER}.{waves}{unknown}"
        return detail + " Velocities alone do not suffice: gravity depends on the positions." * has_rates

    def _ask_to_lock_fingers(self, position: ColumnGroup | None, effort: ColumnGroup) -> Question | None:
        """Ask to lock a few joints at the ends of the arm that stand still, and whose torque is 0 in every row."""
        has_torque = np.count_nonzero(np.nan_to_num(self.values[:, list(effort.columns)]), axis=0) > 0
        if position is None or 2 * np.count_nonzero(has_torque) < self.robot.n:
            return None
        silent = np.flatnonzero(~has_torque & self.robot.has_torque).tolist()
        ends = [joint for joint in silent if not has_torque[list(self.robot.list_subtree(joint))].any()]
        return ask_to_lock_still_joints(self.robot, self.values[:, list(position.columns)], ends)

    def _find_torque_of_most_joints(self, position: ColumnGroup | None) -> list[ColumnGroup]:
        """Return torques of most joints: those of the others were not recorded, or the joints are not the arm's."""
        if position is None:
            return []
        positions = self.values[:, list(position.columns)]
        torque = find_torque_of_most_joints(self.column_names, self.robot, positions, len(self.column_names))
        if isinstance(torque, Question):
            self.questions.append(torque)
        if not isinstance(torque, ColumnGroup):
            return []
        # All joints without a torque share one empty column.
        empty = np.full((len(self.sample.values), 1), np.nan)
        names, values = (*self.sample.names, NOT_RECORDED), np.hstack([self.sample.values, empty])
        self.sample = replace(self.sample, names=names, values=values)
        self.values = np.column_stack([self.values, np.zeros(len(self.values))])
        self.alive = np.append(self.alive, False)
        return [torque]

    def _convert_positions(self, position: ColumnGroup, effort: ColumnGroup) -> FloatArray | None:
        """Return the positions (m, n) in SI, and note their unit."""
        q = np.array(self.values[:, list(position.columns)])  # a copy: the sample keeps the file's units
        # Currents of all joints, and shares of rated torques, have one scale only with the drive gains.
        kind = "current" if effort.signal == "current" or effort.unit in ("permille", "percent") else "tau"
        gains = [drive.gain for drive in self.robot.drives]
        tau = self.values[:, list(effort.columns)] * self.get_factors_to_si(kind, gains)
        units = [self.column_names[index].unit for index in position.columns]
        turning = [unit for unit, joint in zip(units, self.robot.joints, strict=True) if joint.kind == "revolute"]
        stated = turning[0] if turning and len(set(turning)) == 1 else None
        turned = of_units.guess_position_unit(self.robot, q, stated, tau, self.fits)
        if turned is not None and position.named.motor and (stated is None or turned.confidence < of_units.SURE):
            turned = self.doubt_unit_of_motors(self.fits, q, tau, turned)
        joints = [index for index, joint in enumerate(self.robot.joints) if joint.kind == "revolute"]
        by_step = {} if any(turning) else guess_servo_units(q, joints)
        by_joint = by_step or self.guess_units_by_joint(self.fits, position, q, tau, turned)
        mixed = len(joints) < self.robot.n or len({guess.unit for guess in by_joint.values()}) > 1
        for index, joint in enumerate(self.robot.joints):
            if joint.kind == "revolute":
                assert turned is not None
                guess = by_joint.get(index, turned)
            else:
                guess = of_units.guess_stroke_unit(q[:, index], joint.reach, units[index])
            factor, offset = find_conversion("q", joint.kind, guess.unit, "q")
            q[:, index] = q[:, index] * factor + offset
            if mixed or index == 0:
                self.take_unit(f"q{index + 1}" if mixed else "q", guess, "m" if joint.kind == "prismatic" else "rad")
        return q

    def _guess_rates(self, groups: list[ColumnGroup], position: ColumnGroup, q: FloatArray) -> None:
        """Take velocities that are the slope of the positions, and report those that are not."""
        if candidates := self._list_groups(groups, position, "dq"):
            n, group = q.shape[1], min(candidates, key=lambda group: (group.rank, "dq" not in group.named.words))
            correlation, factor = correlate_slopes(self.t, np.column_stack([q, self.values[:, list(group.columns)]]))
            # The slope of each position with the velocity of the same joint.
            own = np.array([correlation[j, n + j] for j in range(n)])
            ratio = np.array([factor[j, n + j] for j in range(n)])
            # A joint that stands has no slope, and cannot speak against the velocities.
            moving = q.std(axis=0) > 0.02 * q.std(axis=0).max()
            guesses = [
                of_units.guess_rate_unit("dq", joint.kind, 1.0 / ratio[j] if ratio[j] > 0 else 0.0, group.unit)
                for j, joint in enumerate(self.robot.joints)
            ]
            fine = [g is not None and own[j] > SLOPE for j, g in enumerate(guesses)]
            usual = {"rad/s" if joint.kind == "revolute" else "m/s" for joint in self.robot.joints}
            same = {g.unit for j, g in enumerate(guesses) if g is not None and moving[j]}
            # Joints that turn and joints that slide have one unit only in SI.
            if all(fine[j] for j in np.flatnonzero(moving)) and (same == usual or len(usual) == len(same) == 1):
                self.assign_columns("dq", group)
                unit = of_units.UnitGuess(", ".join(sorted(same)), 0.97, "it is the derivative of the positions")
                self.take_unit("dq", unit, ", ".join(sorted(usual)))
            elif (reverse := [correlation[n + j, j] for j in np.flatnonzero(moving)]) and min(reverse) > SLOPE:
                both = self.name_columns(position), self.name_columns(group)
                detail = f"{both[0]} are the derivative of {both[1]}: are positions and velocities exchanged?"
                remedy = Remedy("columns", {f"q{j + 1}": self.sample.names[k] for j, k in enumerate(group.columns)})
                self.questions.append(Question("columns/q", f"{detail} Then state {remedy}.", remedies=(remedy,)))
            else:
                are_slopes = (own[moving] > SLOPE).all()
                if are_slopes and find_common_ratio((1.0 / ratio[moving]).tolist(), own[moving].min()):
                    self.assign_columns("dq", group)  # the check of the clock tells of it
                    return
                why = "its unit is not known" if are_slopes else "it is not the derivative of these positions"
                self.add_guess("columns/dq", self.name_columns(group), 0.5, f"not used: {why}")

    def _guess_efforts(self, effort: ColumnGroup, q: FloatArray, kind: EffortKind) -> EffortKind:
        tau, gains = self.values[:, list(effort.columns)], [drive.gain for drive in self.robot.drives]
        if kind == "position_command":
            torque = self.take_servo_law(self.fits, effort, q)
            self._check_against_dynamics(q, torque, effort, in_si=None not in gains)
            return kind
        if effort.unit is None and (zero := find_converter_zero(tau)) is not None:
            zero_of = f"{self.name_columns(effort)} vary about {zero:.4g}, the zero of a converter"
            self.add_question("columns/tau", f"{zero_of}: subtract it, and write them again.")
            return "unknown"
        named, columns = effort.signal, [*effort.columns]
        if named == "tau" and max(columns) < len(self.column_names):
            tau, unit = of_units.convert_mixed_torques(tau, [self.column_names[column].unit for column in columns])
            effort = replace(effort, unit=unit or effort.unit)
        reach = of_units.compute_reach(self.robot)
        torque_unit = of_units.guess_torque_unit(self.robot, tau, None if named == "current" else effort.unit, reach)
        current = of_units.guess_current_unit(tau, gains, self.robot, effort.unit if named == "current" else None)
        by_data = classify_effort(
            self.fits,
            q,
            tau,
            named,
            effort.unit,
            of_units.get_factor("tau", "revolute", torque_unit.unit) if torque_unit.unit in MOMENTS else 1.0,
            {"A": 1.0, "mA": 1e-3}[current.unit] if current.confidence >= of_units.SURE else None,
        )
        if named == "tau" and effort.unit is None:
            torque_unit, by_data = fit_torque_unit(torque_unit, by_data)
        if kind == "unknown":
            kind = by_data.kind
            if kind in ("gravity_compensated", "external", "commanded"):
                self.refuse_kind(
                    kind, f"{self.name_columns(effort)} seem to be of another kind ({by_data.reason}); they"
                )
        unit_note = "" if torque_unit.unit in ("N m", "N") else f" (in {torque_unit.unit})"
        self.add_guess("effort_kind", kind, by_data.confidence, f"{by_data.reason}{unit_note}")
        signal, kind, effort = self.assign_efforts(effort, kind, by_data.reason, known_gains=None not in gains)
        if signal == "current" and named == "tau":
            # Their size was compared as it is: no other unit of currents goes with the drive gains.
            current = of_units.UnitGuess("A", by_data.confidence, by_data.reason)
        if effort.unit not in ("permille", "percent"):
            self.take_effort_unit(signal, torque_unit if signal == "tau" else current, effort)
        in_si = signal == "tau" or None not in gains
        if signal == "current":
            question = ask_for_gains(self.name_columns(effort), effort.unit, gains, self.fits, (q, tau))
            if question is not None:
                # The size of the torques depends on the gains, so it is asked together with them.
                self.questions.append(question)
                in_si = False
        tau = self.values[:, columns] * self.get_factors_to_si(signal, gains)
        self._check_against_dynamics(q, tau, effort, in_si=in_si)
        return kind

    def _ask_about_guessed_time(self) -> None:
        """Ask for the unit of a time that does not state one beside that of torques: it makes right torques wrong."""
        fields = {question.field for question in self.questions}
        if self.clock is None or "units/t" in fields or not any(field.startswith("units/tau") for field in fields):
            return
        if self.clock.unit == "s" or self.column_names[self.clock.column].unit:
            return
        name = self.sample.names[self.clock.column]
        self.questions.insert(0, ask_for_unit_of_time(name, self.clock.unit, self.clock.rate))

    def _check_against_dynamics(self, q: FloatArray, tau: FloatArray, effort: ColumnGroup, *, in_si: bool) -> None:
        """Check the columns against the robot's dynamics; where much is unexplained, that comes first."""
        names = [self.columns[f"q{k + 1}"] for k in range(self.robot.n)], [self.sample.names[k] for k in effort.columns]
        guesses, questions = dynamics_fits.check_against_dynamics(
            self.described_robot, self.fits, q, tau, names, in_si=in_si, silent=self.silent
        )
        if in_si and self.clock is not None:
            ask_about_time(self, self.fits, self.clock, q, tau)
        # Only if much is unexplained: otherwise the guess about the dynamics is among the others.
        first = [g for g in guesses[:1] if g.confidence < of_units.SURE and g.value.endswith("unexplained")]
        self.guesses = [*first, *self.guesses, *guesses[len(first) :]]
        fields = {question.field for question in questions}
        if fields & {"units/tau", "columns"}:
            # By how much torques are off, or whose they are, replaces that they are; what has no choices stays.
            is_scaled = "units/tau" in fields and effort.signal == "tau"
            replaced = ("units/tau", "effort_kind") if is_scaled else ("units/tau",)
            self.questions = [
                question
                for question in self.questions
                if question.field not in replaced or (question.field == "effort_kind" and not question.choices)
            ]
        self.questions += questions
