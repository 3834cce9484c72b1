"""The mutable state of a proposal while it is made: columns assigned so far, guesses and questions."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import Remedy
from dynident.identification.column_inference import dynamics_fits
from dynident.identification.column_inference import unit_inference as of_units
from dynident.identification.column_inference.column_groups import ColumnGroup
from dynident.identification.column_inference.column_names import ColumnName, count_external_axis, read_names
from dynident.identification.column_inference.column_statistics import Sample
from dynident.identification.column_inference.dynamics_fits import BORNE_OUT, DynamicsFits
from dynident.identification.column_inference.metadata_proposal import Guess, Question, ask_for_kind, is_duty
from dynident.identification.column_inference.torque_or_current import NO_MEASUREMENT, ask_for_servo_gains
from dynident.identification.recording_faults.description_fit import describe_weightlessness
from dynident.recordings.columns_to_signals import NOT_RECORDED, compute_servo_error
from dynident.recordings.conditioning.signed_registers import decode_registers
from dynident.recordings.recording_metadata import EffortKind, RecordingError
from dynident.recordings.signal_spectra import fill_gaps
from dynident.recordings.units import FACTORS, find_conversion
from dynident.robot import Robot

_ECHOED, _FOLLOWED = 1e-12, 0.5
"""Shares of the variance of the positions: what commands are ahead of them is less where they are written from the
positions, as where a robot is moved by hand, and more where no joint follows."""


@dataclass
class WorkingProposal:
    """A proposal in the making.

    Parameters
    ----------
    sample : Sample
        Consecutive rows of the file.
    robot : Robot
        The robot, with the masses of its description in SI units.
    described_robot : Robot
        The robot as it was described.
    columns : dict of str to str
        Our names of columns to the file's, as found so far.
    units : dict of str to str
        Units by kind of signal, as found so far.
    guesses : list of Guess
        The guesses so far.
    questions : list of Question
        The questions so far.
    further_efforts : list of str
        Names of columns that may be the torque instead of those that are taken.
    t : (m,)
        Times in s, once the clock is known.
    values : (m, columns)
        The rows that have a time.
    silent : list of int
        Joints whose torque was not recorded.
    """

    sample: Sample
    robot: Robot
    described_robot: Robot
    columns: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    guesses: list[Guess] = field(default_factory=list)
    questions: list[Question] = field(default_factory=list)
    further_efforts: list[str] = field(default_factory=list)
    t: FloatArray = field(default_factory=lambda: np.zeros(0))
    values: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    silent: list[int] = field(default_factory=list)

    @cached_property
    def column_names(self) -> list[ColumnName]:
        """Columns' names, taken apart into signal, joint and unit."""
        links = [joint.link for joint in self.robot.joints if joint.link]
        spoken = [*self.robot.joint_names, *links]
        named = read_names(self.sample.names, self.sample.units, spoken, self.sample.stated)
        return count_external_axis(named, [joint.kind for joint in self.robot.joints])

    def add_guess(
        self, name: str, value: str, confidence: float, reason: str, remedies: tuple[Remedy, ...] = ()
    ) -> None:
        """Add a guess, its confidence, and its reason.

        Parameters
        ----------
        name : str
            Field of the metadata, such as "columns/q".
        value : str
            The proposed value.
        confidence : float
            From 0 to 1.
        reason : str
            The reason, as a clause.
        remedies : tuple of Remedy
            Those that the reason quotes.
        """
        self.guesses.append(Guess(name, value, round(confidence, 2), reason, remedies))

    def add_question(self, name: str, detail: str, choices: tuple[str, ...] = ()) -> None:
        """Add a question that only a person can answer.

        Parameters
        ----------
        name : str
            Field of the metadata.
        detail : str
            The question.
        choices : tuple of str
            Answers that make sense; none where any may be right.
        """
        self.questions.append(Question(name, detail, choices))

    def read_signs(self, group: ColumnGroup, kind: str) -> None:
        """Read unsigned register values as signed ones, as an import does.

        Parameters
        ----------
        group : ColumnGroup
            The columns.
        kind : str
            "q" or "tau".
        """
        columns = list(group.columns)
        decoded, register = decode_registers(self.values[:, columns], self.t, kind)
        if register is None:
            return
        self.values[:, columns] = decoded
        self.sample = replace(self.sample, values=np.array(self.sample.values))
        self.sample.values[:, columns] = register.decode(self.sample.values[:, columns])
        detail = f"{self.name_columns(group)} are signed numbers read as unsigned: {register}. They are corrected."
        self.add_guess("rows/registers", "corrected", 0.95, detail)

    def condition_rows(
        self, fits: DynamicsFits, rows: Sample, position: ColumnGroup, effort: ColumnGroup, q: FloatArray
    ) -> tuple[FloatArray, DynamicsFits, list[Guess]]:
        """Correct positions and efforts as an import will, and keep the rows that it will use.

        Parameters
        ----------
        fits : DynamicsFits
            Fits of the robot to the sample.
        rows : Sample
            The rows with a time.
        position, effort : ColumnGroup
            Columns of the positions, and of the torques or currents.
        q : (m, n)
            Positions in rad or m.

        Returns
        -------
        q : (k, n)
            Positions in rad or m.
        fits : DynamicsFits
            Fits to these rows.
        guesses : list of Guess
            What was corrected.
        """
        positions, efforts = list(position.columns), list(effort.columns)
        known = np.where(np.isfinite(rows.values[:, positions]), q, np.nan)
        try:
            sources = tuple(rows.names[k] for k in positions), tuple(rows.names[k] for k in efforts)
            right, measured, checks = fits.condition_signals(known, rows.values[:, efforts], sources)
        except RecordingError:
            # An error here is about the time, which is asked about elsewhere.
            self.values[:, efforts] = fill_gaps(rows.values[:, efforts])
            return q, fits, []
        faults = [check for check in checks if check.status != "ok"]
        put_right = [Guess(f"rows/{c.name}", "corrected", 0.95, c.detail, c.remedies) for c in faults]
        # Rows in which the drives are off, or samples are missing for long, must not be filled: they hold no torque.
        used = np.asarray(np.isfinite(np.hstack([right, measured])).all(axis=1))
        if not used.any():
            used = np.ones(len(used), dtype=bool)
        self.values[:, efforts] = fill_gaps(measured)
        self.t, self.values = self.t[used], self.values[used]
        return fill_gaps(right)[used], fits.select_rows(used), put_right

    def take_unit(self, key: str, guess: of_units.UnitGuess, usual: str) -> None:
        """Take a guessed unit, and ask where it is not sure.

        Parameters
        ----------
        key : str
            Kind of signal, or one of our names of columns.
        guess : UnitGuess
            The unit with its confidence.
        usual : str
            The unit in SI, which need not be stated.
        """
        if guess.unit != usual:
            self.units[key] = guess.unit
        self.add_guess(f"units/{key}", guess.unit, guess.confidence, guess.reason)
        if guess.confidence < of_units.SURE:
            usual_ones = {"q": ("rad", "deg"), "t": ("s", "ms"), "current": ("A", "mA")}
            choices = guess.choices or usual_ones.get(key.rstrip("0123456789"), ("N m", "mN m"))
            self.add_question(f"units/{key}", f"In which unit is {key}? {guess.reason}.", choices)

    def take_effort_unit(self, signal: str, guess: of_units.UnitGuess, effort: ColumnGroup) -> None:
        """Take the unit of torques or currents.

        Parameters
        ----------
        signal : str
            "tau" or "current".
        guess : UnitGuess
            The unit.
        effort : ColumnGroup
            Their columns.
        """
        if signal == "current":
            self.take_unit("current", guess, "A")
            return
        if effort.signal == "effort" and effort.unit is None and guess.unit not in ("N m", "N"):
            # The name does not say torque: a current, a register, or a position error times a gain may be as large.
            reason = (
                f"{guess.reason}: if it is really a torque, and not a current, a register or the error of a controller"
            )
            guess = of_units.UnitGuess("N m", 0.5, reason, ("N m", guess.unit))
        n_columns = len(self.column_names)
        stated = [self.column_names[column].unit if column < n_columns else None for column in effort.columns]
        mixed = len({other.kind for other in self.robot.joints}) > 1 or len(set(stated)) > 1
        for index, (joint, own) in enumerate(zip(self.robot.joints, stated, strict=True)):
            if mixed or index == 0:
                # A force of the same size: N for N m, unless the column itself states a unit.
                units = [u.partition(" ")[0] if joint.kind == "prismatic" else u for u in (guess.unit, *guess.choices)]
                unit = own if mixed and own in FACTORS["tau", joint.kind] else units[0]
                reason = guess.reason if unit == guess.unit else f"a force, where torques are in {guess.unit}"
                reason = f"its name says {own}" if unit == own else reason
                joint_guess = of_units.UnitGuess(unit, guess.confidence, reason, tuple(dict.fromkeys(units[1:])))
                self.take_unit(f"tau{index + 1}" if mixed else "tau", joint_guess, joint.effort_unit)

    def guess_units_by_joint(
        self,
        fits: DynamicsFits,
        position: ColumnGroup,
        q: FloatArray,
        tau: FloatArray,
        turned: of_units.UnitGuess | None,
    ) -> dict[int, of_units.UnitGuess]:
        """Return units of positions joint by joint, where one for all is ruled out by the names or by the dynamics.

        Parameters
        ----------
        fits : DynamicsFits
            Of the sample.
        position : ColumnGroup
            Columns of the positions.
        q, tau : (m, n)
            As the file has them.
        turned : UnitGuess, optional
            The one unit of all joints that turn.

        Returns
        -------
        dict of int to UnitGuess
            By joint, from 0; empty where one unit goes.
        """
        joints = [index for index, joint in enumerate(self.robot.joints) if joint.kind == "revolute"]
        stated = {index: self.column_names[position.columns[index]].unit or "" for index in joints}
        known = {index: unit for index, unit in stated.items() if unit in FACTORS["q", "revolute"]}
        if len(known) == len(joints) and len(set(known.values())) > 1:
            return {index: of_units.UnitGuess(unit, 0.99, f"its name says {unit}") for index, unit in known.items()}
        if turned is None or known:
            return {}
        is_sure = turned.unit in ("rad", "deg") and turned.confidence >= of_units.SURE
        other = dynamics_fits.find_units_by_joint(fits, q, tau, turned.unit) if is_sure else None
        other = other or dynamics_fits.find_scales_by_joint(fits, q, tau, turned.unit)
        if other is None:
            return {}
        units, reason, is_estimate = other
        if is_estimate:
            remedy = Remedy("units", {f"q{index + 1}": unit for index, unit in units.items()})
            detail = f"In which unit are the positions? {reason}: {remedy}."
            self.questions.append(Question("units/q", detail, remedies=(remedy,)))
        return {index: of_units.UnitGuess(unit, 0.95, reason) for index, unit in units.items()}

    def doubt_unit_of_motors(
        self, fits: DynamicsFits, q: FloatArray, tau: FloatArray, guess: of_units.UnitGuess
    ) -> of_units.UnitGuess:
        """Return the unit of positions that are called those of motors: in doubt where the dynamics do not bear it out.

        Parameters
        ----------
        fits : DynamicsFits
            Of the sample.
        q, tau : (m, n)
            As the file has them.
        guess : UnitGuess
            The unit of angles of joints.
        """
        factor, offset = find_conversion("q", "revolute", guess.unit, "q")
        unexplained = fits.measure_unexplained(q * factor + offset, tau)
        if unexplained is not None and unexplained < BORNE_OUT:
            return guess
        reason = (
            "they are called positions of motors, and as angles of the joints they do not go with the torques: if "
            "gears are behind the motors, say counts per turn of each joint, q1=counts:N and so on, with N the gear "
            "ratio for turns, 360 times it for degrees, 6.28319 times it for rad"
        )
        return of_units.UnitGuess(guess.unit, 0.5, reason, ("counts:N", guess.unit))

    def refuse_kind(self, kind: EffortKind, names: str) -> None:
        """Ask for the measured torque in the place of efforts that are none.

        Parameters
        ----------
        kind : str
            Kind of effort, such as "commanded".
        names : str
            Names of their columns.
        """
        cure, remedies = describe_weightlessness(self.robot) if kind == "gravity_compensated" else ("", ())
        detail = f"{names} are {NO_MEASUREMENT[kind]}. No model can be identified from them; give the measured torque."
        self.questions.append(Question("effort_kind", detail + cure, remedies=remedies))

    def mark_unrecorded_torques(self, effort: ColumnGroup) -> None:
        """Treat torques that hold no number as not recorded, as an import does."""
        raw = np.array(self.sample.values)
        empty = np.asarray(~np.isfinite(raw).any(axis=0))
        for joint, column in enumerate(effort.columns):
            if not empty[column]:
                continue
            raw[:, column] = self.values[:, column] = 0.0
            name = self.robot.joint_names[joint]
            lock = Remedy("locked_joints", {name: 0})
            reason = f"{name} has no torque: its equation is left out (only a finger: {lock})"
            self.add_guess(f"columns/tau{joint + 1}", self.sample.names[column], 0.9, reason, (lock,))
            self.silent.append(joint)
        self.sample = replace(self.sample, values=raw)

    def find_command(self, groups: list[ColumnGroup], position: ColumnGroup | None) -> list[ColumnGroup]:
        """Find commanded positions that the joints follow; from here on their columns hold what they are ahead.

        Parameters
        ----------
        groups : list of ColumnGroup
            All groups of columns.
        position : ColumnGroup, optional
            Columns of the measured positions.

        Returns
        -------
        list of ColumnGroup
            One group; none where there are no such commands.
        """
        if position is None:
            return []
        for group in groups:
            if group.signal != "q" or group.rank < 4 or group is position or group.unit != position.unit:
                continue
            commands, positions = list(group.columns), list(position.columns)
            ahead = self.values[:, commands] - self.values[:, positions]
            spread = np.maximum(self.values[:, positions].var(axis=0), np.finfo(float).tiny)
            if not _ECHOED < np.median(ahead.var(axis=0) / spread) <= _FOLLOWED:
                continue
            self.values, raw = np.array(self.values), np.array(self.sample.values)
            self.values[:, commands] = ahead
            raw[:, commands] -= raw[:, positions]
            self.sample = replace(self.sample, values=raw)
            return [group]
        return []

    def take_servo_law(self, fits: DynamicsFits, command: ColumnGroup, q: FloatArray) -> FloatArray:
        """Take commands of position servos, and ask for gains that are missing.

        Parameters
        ----------
        fits : DynamicsFits
            Of the sample.
        command : ColumnGroup
            Columns of the commands, which hold what these are ahead of the positions.
        q : (m, n)
            Positions in rad or m.

        Returns
        -------
        (m, n)
            Torques in N m or N; without gains the position errors in rad or m.
        """
        fits.from_commands = True
        self.assign_columns("q_command", command)
        followed = "there is no torque, and the joints follow these commands"
        self.add_guess("effort_kind", "position_command", 0.9, followed)
        error = np.array(self.values[:, list(command.columns)])  # in the unit of the positions
        for index, joint in enumerate(self.robot.joints):
            for key in (f"q{index + 1}", "q"):
                if key in self.units:
                    error[:, index] *= find_conversion("q", joint.kind, self.units[key], key)[0]
                    self.units[f"q_command{key[1:]}"] = self.units[key]
                    break
        error = compute_servo_error(error, np.zeros_like(error))
        gains = [drive.gain for drive in self.robot.drives]
        if None not in gains:
            return np.asarray(error * np.array(gains, dtype=float))
        self.questions.append(ask_for_servo_gains(fits, self.name_columns(command), q, error))
        return error

    def assign_columns(self, signal: str, group: ColumnGroup) -> None:
        """Assign the columns of a group to a signal of the joints.

        Parameters
        ----------
        signal : str
            "q", "dq", "tau", "current" or "q_command".
        group : ColumnGroup
            One column for each joint.
        """
        for joint, column in enumerate(group.columns):
            name = self.sample.names[column]
            self.columns[f"{'tau' if name == NOT_RECORDED else signal}{joint + 1}"] = name
        confidence = 0.95 if group.rank < 4 or signal == "q_command" else 0.6
        self.add_guess(f"columns/{signal}", self.name_columns(group), confidence, group.reason)

    def assign_efforts(
        self, effort: ColumnGroup, kind: EffortKind, reason: str, *, known_gains: bool
    ) -> tuple[str, EffortKind, ColumnGroup]:
        """Assign efforts to torques or currents, and ask what they are where that is not known.

        Parameters
        ----------
        effort : ColumnGroup
            Their columns.
        kind : str
            What they are, or "unknown".
        reason : str
            Why they are no torques of the joints, as a clause.
        known_gains : bool
            Whether all drive gains are known.

        Returns
        -------
        tuple of str, str and ColumnGroup
            "tau" or "current", what they are, and the columns with their unit.
        """
        names = self.name_columns(effort)
        signal = "current" if effort.signal == "current" else "tau"
        if is_duty(effort.named.words):
            self.questions.append(ask_for_kind(names, effort.named.words))
        elif effort.unit in ("permille", "percent"):
            signal, kind = "current", "motor_torque" if kind == "unknown" else kind
            self.add_guess(
                "units/current",
                f"{effort.unit} of the rated torque",
                0.9,
                f"its name says {effort.unit}; drive gains are then N m per {effort.unit}",
            )
        elif effort.named.strange_unit:
            unit, signal = effort.named.strange_unit, "tau"
            detail = (
                f"{names} are in {unit}, which is not a unit of torque: take them as currents (current1=…), and give "
                f"drive gains in N m per {unit}."
            )
            self.add_question("effort_kind", detail, ("motor_current",))
        elif effort.signal == "effort":
            if kind == "unknown":
                self.questions.append(ask_for_kind(names, effort.named.words))
            signal = "current" if kind == "motor_current" else "tau"
        elif kind == "motor_torque" and known_gains:
            # Drive gains are N m per unit of these numbers, whatever that is.
            signal, effort = "current", replace(effort, unit="A")
        elif kind == "unknown" and signal == "tau":
            detail = (
                f"What are {names}? They are called torques, but {reason}: torques of the joints, with such inertias, "
                "or of the motors before the gears?"
            )
            self.add_question("effort_kind", detail, ("joint_torque", "motor_torque"))
        self.assign_columns(signal, effort)
        return signal, kind, effort

    def name_columns(self, group: ColumnGroup) -> str:
        """Return the names of the first and the last column of a group."""
        first, last = (self.sample.names[group.columns[place]] for place in (0, -1))
        return f"{first} … {last}" if first != last else first

    def get_factors_to_si(self, signal: str, gains: list[float | None]) -> FloatArray:
        """Return the factors that make N m or N of the effort's numbers.

        Parameters
        ----------
        signal : str
            "tau" or "current".
        gains : list of float or None
            Drive gains of the joints; None where one is not known.

        Returns
        -------
        (n,)
            1 where a factor is not known.
        """
        factors = np.ones(self.robot.n)
        for index, joint in enumerate(self.robot.joints):
            unit = self.units.get(f"{signal}{index + 1}", self.units.get(signal))
            if signal == "tau" and unit is not None:
                factors[index] = of_units.get_factor("tau", joint.kind, unit)
            elif signal == "current":
                factors[index] = (gains[index] or 1.0) * {"mA": 1e-3}.get(unit or "A", 1.0)
        return factors
