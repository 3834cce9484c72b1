"""An identified model with the data that it stands on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import overload

from dynident.arrays import FloatArray
from dynident.desk.choosing import Addition, added_effects, named_effects
from dynident.desk.figure import Figure, check_folder, figure_of
from dynident.desk.frames import Columns, Framed, columns_of
from dynident.desk.parameters import ErrorTable, Parameters
from dynident.desk.recordings import Recordings, SomeRecordings, as_recordings
from dynident.desk.texts import text_table
from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.estimation import Errors
from dynident.export import PredictingModel, TorquePredictor
from dynident.html import block, folded, listed, paragraph, table
from dynident.identification import Identification, check_same_recordings, extend, remove, to_bytes
from dynident.identification.study.gain import best_rung
from dynident.identification.study.prediction import PredictedTorque, predict
from dynident.progress import Progress, silent
from dynident.reports.numbers import counted, number, percent
from dynident.reports.words import place_text, rung_mark, shape_text, title_of
from dynident.robot import Robot
from dynident.verdict import ModelVerdict, Outcome, verdict

NO_DATA = Recordings(())
_LONGEST = 90


@dataclass(frozen=True, eq=False)
class Model:
    """An identified model: `identification` as the library knows it, and the recordings that it was made from.

    `recordings` are those that its parameters were fitted to, `validation` those that no parameter saw. Both are empty
    in a model that comes out of a file, until `with_data` gives them.
    """

    identification: Identification
    recordings: Recordings = NO_DATA
    validation: Recordings = NO_DATA

    @property
    def robot(self) -> Robot:
        """The robot that was identified."""
        return self.identification.model.robot

    @cached_property
    def parameters(self) -> Parameters:
        """The base parameters with their standard deviations and intervals."""
        return Parameters(self.identification.parameters)

    @property
    def effects(self) -> tuple[EffectChoice, ...]:
        """The effects that are in the model."""
        return self.identification.choices.effects

    @property
    def fit(self) -> Errors:
        """Errors on all rows of the data that it was identified from: `fit.relative_total`, `fit.relative` (n,), …"""
        return self.identification.fit

    @property
    def held_out(self) -> Errors | None:
        """Errors on all rows of the validation data; None where there were none."""
        return self.identification.held_out

    @cached_property
    def errors(self) -> ErrorTable:
        """Errors joint by joint: of the fit and held out, where the joint moves and on all rows."""
        return ErrorTable.of(self.identification)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the identification warns of."""
        return self.identification.warnings

    @property
    def ladder(self) -> Ladder:
        """The models that led here, the first one first, and this one last."""
        return Ladder(tuple(Model(rung, self.recordings, self.validation) for rung in self.identification.ladder()))

    @property
    def summary(self) -> str:
        """How good the model is, in a few sentences."""
        found = self.identification
        good = sum(one.well_identified for one in self.parameters)
        held_out = "" if found.held_out is None else f", {percent(found.held_out.relative_total)} on held-out data"
        sentences = [
            f"The relative error of the torque is {percent(found.fit.relative_total)} in the fit{held_out}.",
            f"{good} of {counted(found.model.n_parameters, 'base parameter')} are determined by the data.",
            f"The condition number of W is {number(found.condition_number)}; there are "
            f"{found.equations_per_parameter:.0f} equations per parameter.",
        ]
        if found.warnings:
            sentences.append(f"There {'is' if len(found.warnings) == 1 else 'are'} "
                             f"{counted(len(found.warnings), 'warning')}.")  # fmt: skip
        return " ".join(sentences)

    def verdict(self, validations: Sequence[Outcome] = ()) -> ModelVerdict:
        """What the model is fit for (simulation, feed-forward, collision detection, payload), why not, what to do next.

        Without the recordings (see `with_data`) neither what the held-out data share with those of the fit nor the
        cause of a gross mistake is looked for, and simulation, collision detection and payload are not judged.

        Parameters
        ----------
        validations : sequence of Outcome, optional
            What `validate` gave: a test that failed revises the verdict of the use that it is about.
        """
        checks = {one.name: one.checks for one in (*self.recordings, *self.validation)}
        return verdict(self.identification, self.recordings.recordings, self.validation.recordings, checks, validations)

    def extend(self, *what: Addition, progress: Progress = silent) -> Model:
        """Add effects, one rung of the ladder each, on the data that the model was identified from.

        Parameters
        ----------
        what : diagnosis, ranked effect, effect choice or text
            Of a diagnosis all that it recommends, in its order; a text as "stribeck@joint2" or
            "stribeck@joint1+joint2:vs=0.05".

        Raises
        ------
        DynidentError
            Where nothing would be added, an effect does not fit the robot, or the model has no data (see `with_data`).
        """
        added = added_effects(what, self.robot)
        self.check_data("extend the model")
        grown = extend(self.identification, added, self.recordings.recordings, self.validation.recordings, progress)
        return replace(self, identification=grown)

    def remove(self, *what: EffectChoice | str) -> Model:
        """Take effects out again: off the joints that are named, or off all. Needs no recordings.

        Raises
        ------
        DynidentError
            Where one of them is not in the model, or nothing would be left.
        """
        return replace(self, identification=remove(self.identification, named_effects(what)))

    def with_data(self, recordings: SomeRecordings, validation: SomeRecordings = ()) -> Model:
        """The same model with the recordings that it was identified from, and those that no parameter saw.

        Raises
        ------
        DynidentError
            Where they are not called as those that it was identified from, or hold other samples.
        """
        learnt, tried = as_recordings(recordings), as_recordings(validation)
        _check_names(learnt, self.identification.data.measurement_names, "was identified from")
        check_same_recordings(self.identification, learnt.recordings)
        if tried and self.identification.data.validation_names:
            _check_names(tried, self.identification.data.validation_names, "was tried on")
        return replace(self, recordings=learnt, validation=tried)

    def check_data(self, purpose: str) -> None:
        """Raise `DynidentError` where the model has no recordings to do something with."""
        if not self.recordings:
            names = ", ".join(self.identification.data.measurement_names)
            raise DynidentError(
                f"to {purpose} takes the recordings that it was identified from ({names}), and a file holds the model "
                "alone; read them and give them: model = model.with_data(recordings, validation)",
                title="Recordings needed",
            )

    def predict(self, q: FloatArray, dq: FloatArray, ddq: FloatArray, *, level: float = 0.95) -> PredictedTorque:
        """Predict torque along a motion, with its interval.

        Parameters
        ----------
        q, dq, ddq : (m, n) arrays
            Samples of one motion in the order of time: rad, rad/s, rad/s² (m, …). Hysteresis remembers the path.
        level : float
            Probability of the intervals.

        Returns
        -------
        PredictedTorque
            `torque` (m, n) in N m or N; `half_width` of the interval of what would be measured, `mean_half_width` of
            that of the model's own torque.

        Raises
        ------
        DynidentError
            For arrays that do not fit, or effects that depend on more than the motion.
        """
        return predict(self.identification.estimate, q, dq, ddq, level=level)

    def predictor(self) -> TorquePredictor:
        """Return a predictor for a controller: `step(q, dq, ddq)` once a sample, `reset()` before a new motion."""
        return PredictingModel.of(self.identification).predictor()

    def save(self, path: str | Path) -> None:
        """Write the model, with the models that led to it, to an .npz file; `load_model` reads it, and so do commands.

        The recordings are not in it, only what they come down to: enough to predict, to remove effects, to solve anew.

        Raises
        ------
        DynidentError
            For another ending, or a folder that is not there.
        """
        path = Path(path)
        if path.suffix != ".npz":
            raise DynidentError(f"cannot write {path.name}; the file's ending has to be .npz", pointer=str(path))
        check_folder(path)
        path.write_bytes(to_bytes(self.identification))

    def plot(self) -> Figure:
        """Draw the error of every model of the ladder, in total and joint by joint."""
        return self.ladder.plot()

    def __repr__(self) -> str:
        inner = repr(self.identification).removeprefix("Identification(").removesuffix(")")
        warnings = len(self.warnings)
        words = f"; {warnings} warning{'s' if warnings > 1 else ''} (.warnings)" if warnings else ""
        return f"Model({inner}{words})"

    def _repr_html_(self) -> str:
        return block(
            paragraph(f"Model of {self.robot.name}", strong=True),
            paragraph(self.summary),
            self.errors._repr_html_(),
            listed(self.warnings),
            folded("parameters", self.parameters._repr_html_()),
            folded("ladder", self.ladder._repr_html_()),
        )


@dataclass(frozen=True, eq=False)
class Ladder(Sequence[Model], Framed):
    """Models in the order in which one was made from the other, the first one first.

    `to_frame` has a row a model, the first one first: model (its number, from 1), new (what it adds and leaves out, in
    words), parameters (how many), fit, fit_moving, held_out and held_out_moving (relative errors of the torque,
    fractions, on all rows and where joints move; missing where there is no such data), best and rises (on held-out
    data).
    """

    items: tuple[Model, ...]

    def _columns(self) -> Columns:
        models = [one.identification for one in self.items]
        found = best_rung(models)
        rows = []
        for k, one in enumerate(models):
            errors = (one.fit, one.fit_moving, one.held_out, one.held_out_moving)
            totals = (None if error is None else error.relative_total for error in errors)
            best, rises = (False, False) if found is None else (k == found.best, k in found.rises)
            rows.append((k + 1, _whole_change(one), one.model.n_parameters, *totals, best, rises))
        return columns_of(_FRAME_COLUMNS, rows)

    def plot(self) -> Figure:
        """Draw the error of every model, in total and joint by joint."""
        from dynident.reports.figures.ladder import models_figure

        count = counted(len(self.items), "model")
        return figure_of(
            [models_figure([one.identification for one in self.items])], f"errors of {count}, joint by joint"
        )

    def __len__(self) -> int:
        return len(self.items)

    def __iter__(self) -> Iterator[Model]:
        return iter(self.items)

    @overload
    def __getitem__(self, index: int) -> Model: ...
    @overload
    def __getitem__(self, index: slice) -> Ladder: ...
    def __getitem__(self, index: int | slice) -> Model | Ladder:
        return Ladder(self.items[index]) if isinstance(index, slice) else self.items[index]

    def __repr__(self) -> str:
        return text_table(f"Ladder({len(self.items)})", _COLUMNS, list(self._rows()), len(self.items), right_from=2)

    def _repr_html_(self) -> str:
        return table(_COLUMNS, list(self._rows()), right_from=2)

    def _rows(self) -> Iterator[tuple[str, ...]]:
        models = [one.identification for one in self.items]
        best = best_rung(models)
        for k, one in enumerate(models):
            held_out = "–" if one.held_out is None else percent(one.held_out.relative_total)
            fit, mark = percent(one.fit.relative_total), rung_mark(best, k, len(models))
            yield str(k + 1), _change(one), str(one.model.n_parameters), fit, held_out, mark


def _check_names(given: Recordings, wanted: tuple[str, ...], use: str) -> None:
    if given.names != wanted:
        raise DynidentError(
            f"the model {use} {', '.join(wanted)}; these recordings are {', '.join(given.names) or 'none'}",
            title="Other recordings",
        )


_FRAME_COLUMNS = (
    "model", "new", "parameters", "fit", "fit_moving", "held_out", "held_out_moving", "best", "rises",
)  # fmt: skip
_COLUMNS = ("model", "what is new", "parameters", "fit", "held out", "")


def _whole_change(one: Identification) -> str:
    robot = one.model.robot
    if one.step.parent is None:
        return ", ".join(dict.fromkeys(title_of(choice.effect) for choice in one.choices.effects))
    added = [_words(choice, robot) for choice in one.step.added]
    return ", ".join([*added, *(f"without {_words(choice, robot)}" for choice in one.step.removed)])


def _change(one: Identification) -> str:
    words = _whole_change(one)
    return words if len(words) <= _LONGEST else f"{words[: _LONGEST - 1]}…"


def _words(choice: EffectChoice, robot: Robot) -> str:
    shape = f" ({shape_text(choice)})" if choice.shape else ""
    return f"{title_of(choice.effect)} on {place_text(choice.joints, robot.joint_names)}{shape}"
