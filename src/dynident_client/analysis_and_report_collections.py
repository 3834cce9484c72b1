"""Collections of later results: comparisons, diagnoses, series, validations, drive gains, currents, reports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, Unpack

from dynident_client import answers
from dynident_client.collection_bases import Collection
from dynident_client.computation_options import (
    DiagnosisOptions,
    DriveGainsOptions,
    ReportOptions,
    ValidationKind,
    ValidationOptions,
)
from dynident_client.identification_collection import list_effects
from dynident_client.resource_objects import (
    Comparison,
    CurrentModels,
    Diagnosis,
    DriveGains,
    Record,
    Report,
    Series,
    Validation,
    get_identifier,
)

Effects = Sequence[Mapping[str, object] | str]


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

    def why_not(self, diagnosis: Record | str, effect: str, joint: str | None = None) -> answers.Reason:
        """Read why an effect is, or is not, among those that are recommended.

        Parameters
        ----------
        diagnosis : Record or str
            The diagnosis or its identifier.
        effect : str
            Id of the effect.
        joint : str, optional
            Name of the joint; by default, the one that the effect explains most.

        Returns
        -------
        answers.Reason
            The reason: code, values, and the sentence `text`.
        """
        path = f"{self.path}/{get_identifier(diagnosis)}/why"
        return self._transport.get(path, answers.Reason, effect=effect, joint=joint)

    def detection_limits(self, diagnosis: Record | str) -> list[answers.DetectionLimitOfJoint]:
        """Read the smallest size of each effect on each joint that the recordings would have shown (95 %)."""
        path = f"{self.path}/{get_identifier(diagnosis)}/limits"
        return self._transport.get(path, list[answers.DetectionLimitOfJoint])


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
            "effects": None if effects is None else list_effects(effects),
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
