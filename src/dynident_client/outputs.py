"""Collections of results: identifications, comparisons, diagnoses, validations, gains, currents, reports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, Unpack

from dynident_client import answers
from dynident_client.collection import Collection, LabelledCollection, replace_resources
from dynident_client.records import (
    Batch,
    Comparison,
    CurrentModels,
    Diagnosis,
    DriveGains,
    Identification,
    Record,
    Report,
    Series,
    Validation,
    get_identifier,
)
from dynident_client.requests import (
    DiagnosisOptions,
    DriveGainsOptions,
    IdentificationOptions,
    ReportOptions,
    ValidationKind,
    ValidationOptions,
)

Effects = Sequence[Mapping[str, object] | str]


class Identifications(LabelledCollection[Identification]):
    """Identified models."""

    kind = Identification

    def create(
        self,
        robot: Record | str,
        measurements: Sequence[Record | str],
        *,
        validation: Sequence[Record | str] = (),
        effects: Effects | None = None,
        **more: Unpack[IdentificationOptions],
    ) -> Identification:
        """Identify the base parameters of a robot.

        Parameters
        ----------
        robot : Record or str
            The robot or its identifier.
        measurements, validation : sequence of Record or str
            Measurements to identify from, and to try the model on, or their identifiers.
        effects : sequence, optional
            Effects of the model: ids, or mappings with effect, joints and so on; the usual ones where not given.
        **more : object
            Other fields of the request, as `IdentificationOptions` has them.

        Returns
        -------
        Identification
            The model, whose job is queued; see `wait`.
        """
        body: dict[str, object] = {
            "robot_id": get_identifier(robot),
            "measurement_ids": [get_identifier(measurement) for measurement in measurements],
            # Held-out measurements: no parameter is fitted to them.
            "validation_ids": [get_identifier(measurement) for measurement in validation],
            "effects": None if effects is None else _list_effects(effects),
            **more,
        }
        return self._post(body)

    def create_many(self, bodies: Sequence[Mapping[str, object]]) -> Batch:
        """Identify many models by one request: all are accepted, or none.

        Parameters
        ----------
        bodies : sequence of mapping
            Requests {"robot_id", "measurement_ids", …} as the contract has them; resources may stand for ids.

        Returns
        -------
        Batch
            The batch, with all its identifications.
        """
        # Resources may stand anywhere in these requests, which are given as the contract has them.
        items = [replace_resources(body) for body in bodies]
        return Batch(self._transport, self._transport.post(Batch.path, dict, {"items": items}))

    def batch(self, batch: Batch | str) -> Batch:
        """Read a batch: its identifications, and how many are in which state."""
        return Batch(self._transport, self._transport.get(f"{Batch.path}/{get_identifier(batch)}", dict))

    def cancel_batch(self, batch: Batch | str) -> Batch:
        """Stop all identifications of a batch that have not ended."""
        return Batch(self._transport, self._transport.post(f"{Batch.path}/{get_identifier(batch)}/cancel", dict))

    def forget_batch(self, batch: Batch | str) -> None:
        """Delete a batch; its identifications stay."""
        self._transport.delete(f"{Batch.path}/{get_identifier(batch)}")

    def extend(self, identification: Record | str, effects: Effects, *, name: str | None = None) -> Identification:
        """Add effects: a new identification, whose parent is this one, with a step of the ladder for each of them.

        Parameters
        ----------
        identification : Record or str
            The model or its identifier.
        effects : sequence
            Ids of effects, or mappings with effect, joints and so on.
        name : str, optional
            What the new model is called.

        Returns
        -------
        Identification
            The new model, whose job is queued; see `wait`.
        """
        return self._post(
            {"effects": _list_effects(effects), "name": name}, f"/{get_identifier(identification)}/extend"
        )

    def remove(self, identification: Record | str, effects: Effects, *, name: str | None = None) -> Identification:
        """Take effects out, off some joints or off all: a new identification, whose parent is this one.

        Parameters
        ----------
        identification : Record or str
            The model or its identifier.
        effects : sequence
            Ids of effects, or mappings with effect, joints and so on.
        name : str, optional
            What the new model is called.

        Returns
        -------
        Identification
            The new model, whose job is queued; see `wait`.
        """
        return self._post(
            {"effects": _list_effects(effects), "name": name}, f"/{get_identifier(identification)}/remove"
        )

    def essential(self, identification: Record | str, *, ratio: float | None = None) -> answers.EssentialView:
        """Read the essential parameters, found by backward elimination, with the errors along the way."""
        return self._transport.get(
            f"{self.path}/{get_identifier(identification)}/essential", answers.EssentialView, ratio=ratio
        )

    def correlation(self, identification: Record | str) -> answers.CorrelationView:
        """Read the correlation of the estimates, and what the motion determines only together, in words."""
        return self._transport.get(f"{self.path}/{get_identifier(identification)}/correlation", answers.CorrelationView)

    def tables(self, identification: Record | str) -> list[answers.Table]:
        """Read the parameters and shape constants as tables in words: title, columns, rows of cells."""
        return self._transport.get(f"{self.path}/{get_identifier(identification)}/tables", answers.Tables)["items"]

    def verdict(self, identification: Record | str) -> answers.VerdictView:
        """Read for which uses the model is fit and why or why not, and whether to stop: uses, held_out, stop, …."""
        return self._transport.get(f"{self.path}/{get_identifier(identification)}/verdict", answers.VerdictView)

    def lineage(self, identification: Record | str) -> list[answers.Rung]:
        """Read the ladder of models that led to this one, the first one first.

        What an extension by several effects made on its way has the id "{id}/1", … and says what it is `part_of`.
        `best` marks the smallest validation error, `rises` the steps above it whose error is larger.

        Parameters
        ----------
        identification : Record or str
            The model or its identifier.

        Returns
        -------
        list of answers.Rung
            The steps of the ladder.
        """
        return self._transport.get(f"{self.path}/{get_identifier(identification)}/lineage", answers.Lineage)["items"]

    def compare_lineages(self, identification: Record | str, against: Record | str) -> answers.Lineage:
        """Read two ladders beside each other.

        Parameters
        ----------
        identification, against : Record or str
            The two models or their identifiers.

        Returns
        -------
        answers.Lineage
            Items, against, common_ancestor, and the differences step by step.
        """
        path = f"{self.path}/{get_identifier(identification)}/lineage"
        return self._transport.get(path, answers.Lineage, against=get_identifier(against))

    def export(
        self,
        identification: Record | str,
        format: Literal["json", "urdf", "mjcf", "c", "casadi"] = "json",
        *,
        nearest: bool | None = None,
        anyway: bool | None = None,
    ) -> bytes:
        """Read the model in a format that other programs read; what the format leaves out stands in the file.

        Parameters
        ----------
        identification : Record or str
            The model or its identifier.
        format : {"json", "urdf", "mjcf", "c", "casadi"}
            Format of the file.
        nearest : bool, optional
            For urdf and mjcf: where no bodies that can exist have the identified parameters, write the nearest that
            can.
        anyway : bool, optional
            Whether a model whose error says that it is not to be used is written, too; it is refused otherwise.

        Returns
        -------
        bytes
            The file.
        """
        path = f"{self.path}/{get_identifier(identification)}/export"
        return self._transport.get_bytes(path, format=format, nearest=nearest, anyway=anyway)


class Comparisons(Collection[Comparison]):
    """Comparisons of models with measurements."""

    kind = Comparison

    def create(self, identification: Record | str, measurement: Record | str, *, name: str | None = None) -> Comparison:
        """Compare a model with a measurement.

        The result has errors on all rows (at rest the distance to what static friction may hold), on `moving` rows, and
        `raw`: on all rows against the predicted torque itself.

        Parameters
        ----------
        identification : Record or str
            The model or its identifier.
        measurement : Record or str
            The measurement or its identifier.
        name : str, optional
            What the comparison is called.

        Returns
        -------
        Comparison
            The comparison, whose job is queued; see `wait`.
        """
        ids = {"identification_id": get_identifier(identification), "measurement_id": get_identifier(measurement)}
        return self._post({**ids, "name": name})

    def series(
        self,
        comparison: Record | str,
        joint: str,
        *,
        start: float | None = None,
        end: float | None = None,
        points: int | None = None,
    ) -> answers.Series:
        """Read a joint's measured and predicted torque over time, thinned for plotting.

        Where the joint stands (`standing`) the prediction is a band from `lower` to `upper`.

        Parameters
        ----------
        comparison : Record or str
            The comparison or its identifier.
        joint : str
            Name of the joint.
        start, end : float, optional
            Seconds of t from which and to which samples are read.
        points : int, optional
            About how many points are left of each signal.

        Returns
        -------
        answers.Series
            The signals over time.
        """
        path = f"{self.path}/{get_identifier(comparison)}/series"
        return self._transport.get(path, answers.Series, joint=joint, from_=start, to=end, points=points)

    def residual_map(
        self, comparison: Record | str, joint: str, x: str, y: str | None = None, *, bins: int | None = None
    ) -> answers.ResidualMap:
        """Read mean, spread and count of a joint's residual over any two signals.

        Parameters
        ----------
        comparison : Record or str
            The comparison or its identifier.
        joint : str
            Name of the joint.
        x : str
            Name of the signal along the first axis.
        y : str, optional
            Name of the signal along the second axis; one axis alone where not given.
        bins : int, optional
            Number of parts of each axis.

        Returns
        -------
        answers.ResidualMap
            The residual, part by part.
        """
        path = f"{self.path}/{get_identifier(comparison)}/residual_map"
        return self._transport.get(path, answers.ResidualMap, joint=joint, x=x, y=y, bins=bins)

    def spectrum(
        self, comparison: Record | str, joint: str, over: Literal["angle", "time"] | None = None
    ) -> answers.Spectrum:
        """Read the amplitude spectrum of a joint's residual, over time or over its own angle.

        Parameters
        ----------
        comparison : Record or str
            The comparison or its identifier.
        joint : str
            Name of the joint.
        over : "angle" or "time", optional
            What frequencies are counted over.

        Returns
        -------
        answers.Spectrum
            Amplitudes by frequency, with the highest peaks.
        """
        path = f"{self.path}/{get_identifier(comparison)}/spectrum"
        return self._transport.get(path, answers.Spectrum, joint=joint, over=over)

    def autocorrelation(
        self, comparison: Record | str, joint: str, *, longest: float | None = None
    ) -> answers.AutocorrelationView:
        """Read the autocorrelation of a joint's residual, and its effective number of samples.

        Parameters
        ----------
        comparison : Record or str
            The comparison or its identifier.
        joint : str
            Name of the joint.
        longest : float, optional
            Longest lag in s.

        Returns
        -------
        answers.AutocorrelationView
            Correlations by lag.
        """
        path = f"{self.path}/{get_identifier(comparison)}/autocorrelation"
        return self._transport.get(path, answers.AutocorrelationView, joint=joint, longest=longest)


class Diagnoses(Collection[Diagnosis]):
    """Diagnoses: what is missing in models."""

    kind = Diagnosis

    def create(
        self,
        identification: Record | str,
        *,
        measurements: Sequence[Record | str] | None = None,
        baseline: Sequence[Record | str] = (),
        **more: Unpack[DiagnosisOptions],
    ) -> Diagnosis:
        """Find what is missing in a model.

        With earlier measurements of the same robot as the baseline, its result says what has changed since (`changes`).

        Parameters
        ----------
        identification : Record or str
            The model or its identifier.
        measurements : sequence of Record or str, optional
            Measurements to look at; those that the model was identified from where none is given.
        baseline : sequence of Record or str
            Earlier measurements of the same robot.
        **more : object
            Other fields of the request, as `DiagnosisOptions` has them.

        Returns
        -------
        Diagnosis
            The diagnosis, whose job is queued; see `wait`.
        """
        body: dict[str, object] = {
            "identification_id": get_identifier(identification),
            "measurement_ids": None
            if measurements is None
            else [get_identifier(measurement) for measurement in measurements],
            "baseline_ids": [get_identifier(measurement) for measurement in baseline],
            **more,
        }
        return self._post(body)

    def evidence(self, diagnosis: Record | str, rank: int, joint: str | None = None) -> answers.Evidence:
        """Read the figure behind a ranked candidate: the residual over what it depends on, with the fitted effect.

        Parameters
        ----------
        diagnosis : Record or str
            The diagnosis or its identifier.
        rank : int
            Rank of the candidate, from 1.
        joint : str, optional
            Name of the joint, where the candidate is on several.

        Returns
        -------
        answers.Evidence
            The curves of the figure.
        """
        return self._transport.get(
            f"{self.path}/{get_identifier(diagnosis)}/evidence", answers.Evidence, rank=rank, joint=joint
        )


class SeriesOfDays(Collection[Series]):
    """Robots over many days."""

    kind = Series

    def create(
        self,
        identification: Record | str,
        days: Sequence[Sequence[Record | str]],
        *,
        names: Sequence[str] | None = None,
        continues: Record | str | None = None,
        name: str | None = None,
    ) -> Series:
        """Find what has changed over the days, from which day on, and the values of every parameter.

        Parameters
        ----------
        identification : Record or str
            The model or its identifier.
        days : sequence of sequence of Record or str
            The measurements of each day, in their order, or their identifiers.
        names : sequence of str, optional
            Names of the days.
        continues : Record or str, optional
            A series of the same model whose days come first and are not read again.
        name : str, optional
            What the series is called.

        Returns
        -------
        Series
            The series, whose job is queued; see `wait`.
        """
        day_requests: list[dict[str, object]] = [
            {"measurement_ids": [get_identifier(measurement) for measurement in day]} for day in days
        ]
        # Days without a name are named by the service.
        for day, day_name in zip(day_requests, names or (), strict=False):
            day["name"] = day_name
        body = {
            "identification_id": get_identifier(identification),
            "days": day_requests,
            "continues": None if continues is None else get_identifier(continues),
            "name": name,
        }
        return self._post(body)

    def figure(self, series: Record | str) -> bytes:
        """Read the drawing of all parameters over the days, an SVG."""
        return self._transport.get_bytes(f"{self.path}/{get_identifier(series)}/figure")


class Validations(Collection[Validation]):
    """Validations of models."""

    kind = Validation

    def create(
        self,
        identification: Record | str,
        kind: ValidationKind,
        *,
        measurements: Sequence[Record | str] | None = None,
        **more: Unpack[ValidationOptions],
    ) -> Validation:
        """Validate a model.

        Parameters
        ----------
        identification : Record or str
            The model or its identifier.
        kind : str
            How the model is tried.
        measurements : sequence of Record or str, optional
            Measurements to try it on, or their identifiers.
        **more : object
            Other fields of the request, as `ValidationOptions` has them.

        Returns
        -------
        Validation
            The validation, whose job is queued; see `wait`.
        """
        measurement_ids = (
            None if measurements is None else [get_identifier(measurement) for measurement in measurements]
        )
        body: dict[str, object] = {
            "identification_id": get_identifier(identification),
            "kind": kind,
            "measurement_ids": measurement_ids,
            **more,
        }
        return self._post(body)


class DriveGainSets(Collection[DriveGains]):
    """Drive gains from runs without and with a known load."""

    kind = DriveGains

    def create(
        self,
        robot: Record | str,
        unloaded: Sequence[Record | str],
        loaded: Sequence[Record | str],
        *,
        weigh: Sequence[Record | str] | None = None,
        weigh_unloaded: Sequence[Record | str] | None = None,
        **more: Unpack[DriveGainsOptions],
    ) -> DriveGains:
        """Identify the drive gains from the same motion without and with a load of known mass.

        Parameters
        ----------
        robot : Record or str
            The robot or its identifier.
        unloaded, loaded : sequence of Record or str
            Measurements without and with the load, or their identifiers.
        weigh : sequence of Record or str, optional
            Measurements of other loads, which are weighed with the gains.
        weigh_unloaded : sequence of Record or str, optional
            Measurements of the same motion as `weigh` without a load; `unloaded` where not given.
        **more : object
            Other fields of the request, as `DriveGainsOptions` has them.

        Returns
        -------
        DriveGains
            The gains, whose job is queued; see `wait`.
        """
        body: dict[str, object] = {
            "robot_id": get_identifier(robot),
            "unloaded": [get_identifier(measurement) for measurement in unloaded],
            "loaded": [get_identifier(measurement) for measurement in loaded],
            "weigh": None if weigh is None else [get_identifier(measurement) for measurement in weigh],
            "weigh_unloaded": None
            if weigh_unloaded is None
            else [get_identifier(measurement) for measurement in weigh_unloaded],
            **more,
        }
        return self._post(body)


class CurrentModelSets(Collection[CurrentModels]):
    """Every joint's parameters in units of its current, for which no drive gain is needed."""

    kind = CurrentModels

    def create(
        self,
        robot: Record | str,
        measurements: Sequence[Record | str],
        *,
        validation: Sequence[Record | str] = (),
        effects: Effects | None = None,
        name: str | None = None,
    ) -> CurrentModels:
        """Identify every joint's parameters in units of its current.

        Parameters
        ----------
        robot : Record or str
            The robot or its identifier; it has a drive gain for every joint, 1 where it is unknown.
        measurements, validation : sequence of Record or str
            Measurements to identify from, and to try the model on, or their identifiers.
        effects : sequence, optional
            Effects of the model: ids, or mappings with effect, joints and so on; the usual ones where not given.
        name : str, optional
            What the models are called.

        Returns
        -------
        CurrentModels
            The models, whose job is queued; see `wait`.
        """
        body: dict[str, object] = {
            "robot_id": get_identifier(robot),
            "measurement_ids": [get_identifier(measurement) for measurement in measurements],
            "validation_ids": [get_identifier(measurement) for measurement in validation],
            "effects": None if effects is None else _list_effects(effects),
            "name": name,
        }
        return self._post(body)


class Reports(Collection[Report]):
    """Reports."""

    kind = Report

    def create(
        self,
        identification: Record | str,
        *,
        diagnosis: Record | str | None = None,
        design: Record | str | None = None,
        validations: Sequence[Record | str] = (),
        measurements: Sequence[Record | str] | None = None,
        **more: Unpack[ReportOptions],
    ) -> Report:
        """Write a report of a model.

        Parameters
        ----------
        identification : Record or str
            The model or its identifier.
        diagnosis : Record or str, optional
            The diagnosis that is reported, or its identifier.
        design : Record or str, optional
            The design that the data come from, or its identifier.
        validations : sequence of Record or str
            Validations that are reported, or their identifiers.
        measurements : sequence of Record or str, optional
            Measurements that are shown; those of the model where none is given.
        **more : object
            Other fields of the request, as `ReportOptions` has them.

        Returns
        -------
        Report
            The report, whose job is queued; see `wait`.
        """
        body: dict[str, object] = {
            "identification_id": get_identifier(identification),
            "diagnosis_id": None if diagnosis is None else get_identifier(diagnosis),
            "design_id": None if design is None else get_identifier(design),
            "validation_ids": [get_identifier(resource) for resource in validations],
            "measurement_ids": None
            if measurements is None
            else [get_identifier(resource) for resource in measurements],
            **more,
        }
        return self._post(body)

    def content(self, report: Record | str) -> bytes:
        """Read the document."""
        return self._transport.get_bytes(f"{self.path}/{get_identifier(report)}/content")


def _list_effects(effects: Effects) -> list[dict[str, object]]:
    return [{"effect": effect} if isinstance(effect, str) else dict(effect) for effect in effects]
