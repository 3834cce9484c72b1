"""`Model`: an identified model with its recordings, from which it is extended, reduced, validated and exported."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dynident.api.argument_checks import require
from dynident.api.effect_arguments import Addition, collect_added_effects, resolve_effects
from dynident.api.figure import Figure, join_figures
from dynident.api.model_results import ModelResults
from dynident.api.named_tables import Framed, FTest, Items, Table, build_columns
from dynident.api.recording_collection import Recordings, SomeRecordings, as_recordings
from dynident.diagnosis import compare
from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.file_output import check_ending, write_atomically
from dynident.identification import Identification, check_same_recordings, extend, remove, to_bytes
from dynident.identification.identified_models.correlated_and_essential_parameters import compare_nested
from dynident.number_format import format_count, format_percent
from dynident.presentation.labels import describe_condition_number
from dynident.presentation.ladder_tables import build_ladder_table, find_best, make_step
from dynident.presentation.tables import ReportedTable
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.recordings import Recording
from dynident.text_and_html_tables import join_html, render_details, render_list, render_paragraph
from dynident.verdict import ModelVerdict, Outcome, verdict

NO_RECORDINGS = Recordings(())


@dataclass(frozen=True, eq=False)
class Model(ModelResults):
    """An identified model.

    A model that was read from a file, or unpickled, has no recordings until `with_data` adds them.

    Parameters
    ----------
    identification : Identification
        The model as the library gives it.
    recordings : Recordings
        Those that the parameters were fitted to.
    validation : Recordings
        Held-out recordings, to which no parameter was fitted.

    Examples
    --------
    >>> model = dy.identify(robot, runs[:1], validation=runs[1:])
    >>> better = model.extend("stribeck@elbow")
    >>> [step.effects[-1].effect for step in better.ladder]
    ['viscous', 'stribeck']
    """

    recordings: Recordings = NO_RECORDINGS
    validation: Recordings = NO_RECORDINGS

    def __reduce__(self) -> tuple[object, ...]:
        # As in a file: temporary files of recordings may be gone when a pickle is read.
        return (type(self), (self.identification,))

    def __copy__(self) -> Model:
        return self

    def __deepcopy__(self, memo: object) -> Model:
        # Nothing of a model can be changed, so a copy would be the same; a pickle would lose the recordings.
        return self

    @property
    def _held_out(self) -> tuple[Recording, ...]:
        return tuple(self.validation.recordings)

    @property
    def ladder(self) -> Ladder:
        """The models that led to this one, in order, with this one as the last."""
        return Ladder(
            tuple(
                Model(identification, self.recordings, self.validation)
                for identification in self.identification.ladder()
            )
        )

    def compare_f_test(self, restricted: Model | Identification) -> FTest:
        """Test whether what this model has beyond a smaller one is more than noise.

        It is a Wald test: what the smaller model lacks is zero, and what it takes as known has that value. The
        parameters are this model's for the estimator "irls". For every other one they are least squares of its rows,
        without limits such as those of "feasible". Residuals are correlated, so independent rows are counted by blocks
        of time, as the standard deviations do. With one joint and the covariance "independent" it is the test of
        statsmodels; several joints have each their noise. An effect whose shape constants were searched on the same
        data looks surer than it is; held-out errors (`dy.Ladder`) do not have this fault, and compare models that are
        not nested.

        Parameters
        ----------
        restricted : Model
            A model of the same recordings and filters, with fewer effects or with known parameters.

        Returns
        -------
        FTest
            `f_value`, `p_value` and `df_diff`, in the order of statsmodels, and `df_resid`.

        Raises
        ------
        DynidentError
            Where the models are of other data, know different values, or are not nested.

        Examples
        --------
        >>> model = dy.identify(robot, runs[:1])
        >>> test = model.extend("stribeck@elbow").compare_f_test(model)
        >>> test.p_value < 0.001
        True
        """
        require(
            isinstance(restricted, (Model, Identification)),
            restricted,
            "restricted",
            "give the smaller model, as identify(…) gives it",
        )
        smaller = restricted.identification if isinstance(restricted, Model) else restricted
        test = compare_nested(self.identification, smaller)
        return FTest.from_test(test)

    def residuals(
        self,
        recordings: SomeRecordings | None = None,
        *,
        raw: bool = False,
        progress: Progress = ignore_progress,
    ) -> Table:
        """Return what the model does not explain of the torque.

        Where a joint moves or reverses that is measured minus predicted torque. Where it stands the sign of its
        friction is unknown: there it is the distance to what static friction may hold, which is mostly 0.

        Parameters
        ----------
        recordings : recordings, optional
            Those that the model was identified from by default.
        raw : bool
            Whether to return measured minus predicted torque on every row, also where a joint stands.
        progress : function, optional
            Called with the fraction done and a message.

        Returns
        -------
        Table
            A row for each filtered, decimated sample: recording (its name), t (s), and a column for each joint (N m, or
            N). These are all rows; the rms of `summary` is over rows where the joint moves. `dynident.compare` has
            more: measured and predicted torque, both residuals, and the phases of the motion.

        Raises
        ------
        DynidentError
            Where there are no recordings (see `with_data`), or they are another robot's.

        Examples
        --------
        >>> model.residuals()["shoulder"].std()  # doctest: +SKIP
        >>> model.residuals(runs[1:]).to_frame().plot(x="t", y="shoulder")  # doctest: +SKIP
        """
        if recordings is None:
            self.check_data("compute residuals")
        checked_recordings = self.recordings if recordings is None else as_recordings(recordings)
        if not checked_recordings:
            raise DynidentError("give at least one recording", pointer="recordings", title="Recordings needed")
        parts = []
        for index, recording in enumerate(checked_recordings.recordings):
            share = scale_progress(progress, index / len(checked_recordings), (index + 1) / len(checked_recordings))
            parts.append(compare(self.identification, recording, share))
        residuals = np.concatenate([part.raw_residual if raw else part.residual for part in parts])
        joints, units = parts[0].joint_names, parts[0].units
        return Table(
            {
                "recording": np.repeat(checked_recordings.names, [len(part.t) for part in parts]),
                "t": np.concatenate([part.t for part in parts]),
                **{name: residuals[:, j] for j, name in enumerate(joints)},
            },
            {"t": "s", **dict(zip(joints, units, strict=True))},
            title=f"Residuals of {', '.join(checked_recordings.names)}: measured minus predicted torque"
            + ("" if raw else "; at standstill the distance to static friction"),
        )

    def verdict(self, validations: Sequence[Outcome] = ()) -> ModelVerdict:
        """Judge what the model is fit for (simulation, feed-forward, collision detection, payload).

        Without the recordings (see `with_data`) simulation, collision detection and payload are not judged, and neither
        shared data of fit and validation nor the cause of a gross fault is searched for.

        Parameters
        ----------
        validations : sequence of Outcome, optional
            Results of `validate`: a failed test revises the verdict on the use that it concerns.

        Returns
        -------
        ModelVerdict
            Whether the model is fit for each use, why, and what to do next.
        """
        require(
            not isinstance(validations, str) and all(isinstance(item, Outcome) for item in validations),
            validations,
            "validations",
            "give the results of dy.validate(model)",
        )
        # Checks of the recordings can veto a verdict, however small the errors are.
        checks = {recording.name: recording.checks for recording in (*self.recordings, *self.validation)}
        return verdict(self.identification, self.recordings.recordings, self.validation.recordings, checks, validations)

    def extend(self, *what: Addition, progress: Progress = ignore_progress) -> Model:
        """Add effects, each as one step of the ladder, on the data that the model was identified from.

        Parameters
        ----------
        what : diagnosis, ranked effect, effect choice or text
            Of a diagnosis all that it recommends, in its order; a text as "stribeck@joint2" or
            "stribeck@joint1+joint2:vs=0.05".
        progress : function, optional
            Called with the fraction done and a message.

        Returns
        -------
        Model
            The new model, whose ladder continues this one's.

        Raises
        ------
        DynidentError
            Where nothing would be added, an effect does not fit the robot, or the model has no data (see `with_data`).
        """
        # Effects are read before the data are asked for, so that a misspelt effect is what the user hears of.
        added = collect_added_effects(what, self.robot)
        self.check_data("extend the model")
        extended = extend(self.identification, added, self.recordings.recordings, self.validation.recordings, progress)
        return replace(self, identification=extended)

    def remove(self, *what: EffectChoice | str) -> Model:
        """Remove effects, from the joints that are named or from all. Needs no recordings.

        Parameters
        ----------
        what : effect choices or texts
            Effects such as "offset" or "stribeck@joint2"; each is taken off the joints that it names, or off all.

        Returns
        -------
        Model
            The new model, whose ladder continues this one's.

        Raises
        ------
        DynidentError
            Where one of them is not in the model, or nothing would be left.
        """
        return replace(self, identification=remove(self.identification, resolve_effects(what)))

    def with_data(self, recordings: SomeRecordings, validation: SomeRecordings = ()) -> Model:
        """Return the model with the recordings that it was identified from, and held-out ones.

        Parameters
        ----------
        recordings : recordings
            Those that the model was identified from, read in the same way.
        validation : recordings
            Held-out recordings; none by default.

        Returns
        -------
        Model
            The same model, which can now be extended, diagnosed and judged.

        Raises
        ------
        DynidentError
            Where they hold other samples than those that it was identified from, or held-out ones have other names.

        Notes
        -----
        A new model of other or further recordings, with the same choices:
        ``dynident.identify(model.robot, recordings, validation=validation, choices=model.identification.choices)``.
        """
        fit_recordings, held_out = as_recordings(recordings), as_recordings(validation)
        # Where the model knows the samples, a copy by another name is the same recording.
        if not self.identification.data.digests:
            _check_recording_names(fit_recordings, self.identification.data.measurement_names, "was identified from")
        check_same_recordings(self.identification, fit_recordings.recordings)
        if held_out and self.identification.data.validation_names:
            _check_recording_names(held_out, self.identification.data.validation_names, "was validated on")
        return replace(self, recordings=fit_recordings, validation=held_out)

    def check_data(self, purpose: str) -> None:
        """Check that the model has its recordings.

        Parameters
        ----------
        purpose : str
            What they are needed for, as a verb, for the message.

        Raises
        ------
        DynidentError
            Where it has none.
        """
        if not self.recordings:
            names = ", ".join(self.identification.data.measurement_names)
            raise DynidentError(
                f"the recordings of the model ({names}) are needed to {purpose}, but the file of a model does not "
                "contain them; read them and add them: model = model.with_data(recordings, validation)",
                title="Recordings needed",
            )

    def save(self, path: str | Path) -> None:
        """Write the model, with the models that led to it, to an .npz file, which `load_model` and the commands read.

        The file does not hold the recordings, only their reduced equations: enough to predict, to remove effects and to
        solve again.

        Parameters
        ----------
        path : path
            The file to write; its ending has to be .npz.

        Raises
        ------
        DynidentError
            For another ending, or a folder that does not exist.
        """
        write_atomically(check_ending(path, (".npz",)), to_bytes(self.identification))

    def plot(self) -> Figure:
        """Draw the errors of every model of the ladder, in total and joint by joint.

        Returns
        -------
        Figure
            Two panels: errors in total, and joint by joint.

        Raises
        ------
        DynidentError
            Where there is no model.
        """
        return self.ladder.plot()

    def __repr__(self) -> str:
        # The library's own representation, under the name of this class.
        inner = repr(self.identification).removeprefix("Identification(").removesuffix(")")
        warnings = len(self.warnings)
        words = f"; {warnings} warning{'s' if warnings > 1 else ''} (.warnings)" if warnings else ""
        return f"Model({inner}{words})"

    def _repr_html_(self) -> str:
        return join_html(
            render_paragraph(f"Model of {self.robot.name}", strong=True),
            render_paragraph(_describe_quality(self.identification)),
            self.errors._repr_html_(),
            render_list(self.warnings),
            render_details("parameters", self.parameters._repr_html_()),
            render_details("ladder", self.ladder._repr_html_()),
        )


@dataclass(frozen=True, eq=False)
class Ladder(Items[Model], Framed):
    """Models in the order in which each was made from the one before.

    Its table has the errors where joints move, by which the best model is chosen. `to_frame` has a row for each model:
    model (its number, from 1), new (what it adds and leaves out, in words), parameters (their number), fit, fit_moving,
    held_out and held_out_moving (relative errors of the torque, fractions, on all rows and where joints move; missing
    where there is no such data), best and rises (on held-out data).

    Parameters
    ----------
    items : tuple of Model
        The models, the first one first.
    """

    items: tuple[Model, ...]

    def _columns(self) -> Table:
        models = [model.identification for model in self.items]
        steps = [make_step(model) for model in models]
        # Without a held-out error of every model no step is best, and no column says so.
        best_step = find_best(steps)
        rows = []
        for k, identification in enumerate(models):
            errors = (
                identification.fit,
                identification.fit_moving,
                identification.held_out,
                identification.held_out_moving,
            )
            totals = (None if error is None else error.relative_total for error in errors)
            best, rises = (False, False) if best_step is None else (k == best_step.best, k in best_step.rises)
            rows.append(
                (
                    k + 1,
                    steps[k].describe_change(identification.model.robot.joint_names),
                    identification.model.n_parameters,
                    *totals,
                    best,
                    rises,
                )
            )
        return build_columns(_FRAME_COLUMNS, rows)

    def plot(self) -> Figure:
        """Draw the errors of every model, in total and joint by joint.

        Returns
        -------
        Figure
            Two panels: errors in total, and joint by joint.
        """
        from dynident.reports.figures.ladder import draw_models

        if not self.items:
            raise DynidentError("nothing to draw: there are no models")
        count = format_count(len(self.items), "model")
        return join_figures(
            [draw_models([model.identification for model in self.items])], f"errors of {count}, joint by joint"
        )

    def __repr__(self) -> str:
        table = self._table()
        return "\n".join([table.to_text(f"Ladder({len(self.items)})"), *table.notes])

    def _repr_html_(self) -> str:
        table = self._table()
        return join_html(table.to_html(), *map(render_paragraph, table.notes))

    def _table(self) -> ReportedTable:
        steps = [make_step(model.identification) for model in self.items]
        return build_ladder_table(steps, self.items[0].robot.joint_names if self.items else ())


def _describe_quality(identification: Identification) -> str:
    n_determined = sum(parameter.well_identified for parameter in identification.parameters)
    n_parameters = format_count(identification.model.n_parameters, "base parameter")
    errors = identification.held_out
    held_out = "" if errors is None else f", {format_percent(errors.relative_total)} on held-out data"
    sentences = [
        f"The relative error of the torque is {format_percent(identification.fit.relative_total)} in the "
        f"fit{held_out}.",
        f"{n_determined} of {n_parameters} are determined by the data.",
        f"The scaled condition number of W is {describe_condition_number(identification)}; there are "
        f"{identification.equations_per_parameter:.0f} equations per parameter.",
    ]
    if identification.warnings:
        sentences.append(f"There {'is' if len(identification.warnings) == 1 else 'are'} "
                         f"{format_count(len(identification.warnings), 'warning')}.")  # fmt: skip
    return " ".join(sentences)


def _check_recording_names(recordings: Recordings, names: tuple[str, ...], use: str) -> None:
    if recordings.names != names:
        raise DynidentError(
            f"the model {use} {', '.join(names)}; these recordings are {', '.join(recordings.names) or 'none'}",
            title="Other recordings",
        )


_FRAME_COLUMNS = (
    "model", "new", "parameters", "fit", "fit_moving", "held_out", "held_out_moving", "best", "rises",
)  # fmt: skip
