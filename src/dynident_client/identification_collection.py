"""Collections of campaigns, and of identifications: create, batches, extend, remove, verdict, tables, export."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Literal, Unpack

from dynident_client import answers
from dynident_client.collection_bases import Collection, LabelledCollection, replace_resources
from dynident_client.computation_options import CampaignOptions, IdentificationOptions
from dynident_client.resource_objects import (
    Batch,
    Campaign,
    Design,
    Identification,
    Record,
    get_identifier,
)

Effects = Sequence[Mapping[str, object] | str]
Rows = Iterable[Iterable[float]]


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
            "effects": None if effects is None else list_effects(effects),
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
        return self._post({"effects": list_effects(effects), "name": name}, f"/{get_identifier(identification)}/extend")

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
        return self._post({"effects": list_effects(effects), "name": name}, f"/{get_identifier(identification)}/remove")

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

    def predict(
        self,
        identification: Record | str,
        q: Rows,
        dq: Rows,
        ddq: Rows,
        *,
        t: Iterable[float] | None = None,
        interval: float | None = None,
        steady: bool = False,
    ) -> answers.PredictedTorqueView:
        """Predict the torque of states, or along a motion.

        Parameters
        ----------
        identification : Record or str
            The model or its identifier.
        q, dq, ddq : rows of numbers (m, n)
            Positions, velocities and accelerations in rad, rad/s and rad/s² (m, m/s and m/s² of joints that slide).
        t : numbers, optional
            Times in s, for effects that depend on them or on derivatives of the acceleration.
        interval : float, optional
            Probability of intervals, such as 0.95; None for the torque alone.
        steady : bool
            Whether each row stands for itself, with friction that slides steadily; otherwise hysteresis remembers the
            rows before.

        Returns
        -------
        answers.PredictedTorqueView
            Torques in N m or N, with the ends of the intervals where they are asked for.
        """
        # Arrays are sent as numbers, too.
        motion = {
            name: [[float(value) for value in row] for row in rows]
            for name, rows in (("q", q), ("dq", dq), ("ddq", ddq))
        }
        times = None if t is None else [float(time) for time in t]
        body = {**motion, "t": times, "interval": interval, "steady": steady}
        path = f"{self.path}/{get_identifier(identification)}/predictions"
        return self._transport.post(path, answers.PredictedTorqueView, body)

    def lineage(self, identification: Record | str) -> list[answers.LadderStep]:
        """Read the ladder of models that led to this one, the first one first.

        What an extension by several effects made on its way has the id "{id}/1", … and says what it is `part_of`.
        `best` marks the smallest validation error, `rises` the steps above it whose error is larger.

        Parameters
        ----------
        identification : Record or str
            The model or its identifier.

        Returns
        -------
        list of answers.LadderStep
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

    def list_exports(self, identification: Record | str) -> answers.ExportsView:
        """Read which formats the model can be written in, what each holds, and its error on held-out data."""
        return self._transport.get(f"{self.path}/{get_identifier(identification)}/exports", answers.ExportsView)

    def export_with_error(
        self, identification: Record | str, format: str, *, nearest: bool = False, anyway: bool = False
    ) -> tuple[bytes, float | None]:
        """Read the model in a format, and the error that its reader computes on held-out data.

        Parameters
        ----------
        identification : Record or str
            The model or its identifier.
        format : str
            A format of `list_exports`; also "cpp", "franka" and "kuka".
        nearest, anyway : bool
            As for `export`.

        Returns
        -------
        tuple of (bytes, float or None)
            The file, and the relative error; None without held-out data, or for a file that is no model of the torque.
        """
        path = f"{self.path}/{get_identifier(identification)}/exports/{format}"
        content, error = self._transport.get_with_header(path, "X-Held-Out-Error", nearest=nearest, anyway=anyway)
        return content, None if error is None else float(error)

    def export(
        self,
        identification: Record | str,
        format: Literal[
            "json",
            "urdf",
            "sdf",
            "mjcf",
            "usd",
            "fmu",
            "mjlab",
            "isaac_lab",
            "c",
            "c_header",
            "cpp_header",
            "casadi",
            "ros2",
            "randomisation",
            "urscript",
            "franka_load",
            "kuka_load",
            "load_urdf",
        ] = "json",
        *,
        nearest: bool | None = None,
        anyway: bool | None = None,
    ) -> bytes:
        """Read the model in a format that other programs read; what the format leaves out stands in the file.

        Parameters
        ----------
        identification : Record or str
            The model or its identifier.
        format : str
            "json", "urdf", "sdf", "mjcf", "usd", "fmu", "mjlab", "isaac_lab", "c", "c_header", "cpp_header", "casadi",
            "ros2", "randomisation", or for the load alone "urscript", "franka_load", "kuka_load", "load_urdf".
            Format of the file.
        nearest : bool, optional
            For files of links and joints (urdf, sdf, mjcf, usd, mjlab, isaac_lab, randomisation): where no bodies that
            can exist have the identified parameters, write the nearest that can.
        anyway : bool, optional
            Whether a model whose error says that it is not to be used is written, too; it is refused otherwise.

        Returns
        -------
        bytes
            The file.
        """
        path = f"{self.path}/{get_identifier(identification)}/export"
        return self._transport.get_bytes(path, format=format, nearest=nearest, anyway=anyway)


def list_effects(effects: Effects) -> list[dict[str, object]]:
    """Return effects as the service takes them: each a mapping, of its name alone where nothing else is stated."""
    return [{"effect": effect} if isinstance(effect, str) else dict(effect) for effect in effects]


class Campaigns(Collection[Campaign]):
    """Campaigns: ask for a motion, move the robot, tell its recording, until the goal is reached or cannot be."""

    kind = Campaign

    def create(
        self,
        robot: Record | str,
        *,
        measurements: Sequence[Record | str] = (),
        **more: Unpack[CampaignOptions],
    ) -> Campaign:
        """Begin a campaign.

        Parameters
        ----------
        robot : Record or str
            The robot or its identifier.
        measurements : sequence of Record or str
            Measurements that it begins with.
        **more : object
            Other fields of the request, as `CampaignOptions` has them.

        Returns
        -------
        Campaign
            The campaign.
        """
        ids = [get_identifier(measurement) for measurement in measurements]
        return self._post({"robot_id": get_identifier(robot), "measurement_ids": ids, **more})

    def ask(self, campaign: Record | str) -> Design:
        """Design the next motion; its result has what it promises (`promised`).

        Parameters
        ----------
        campaign : Record or str
            The campaign or its identifier.

        Returns
        -------
        Design
            The design, whose job is queued; see `wait`.
        """
        return Design(self._transport, self._transport.post(f"{self.path}/{get_identifier(campaign)}/ask", dict))

    def tell(
        self, campaign: Record | str, measurement: Record | str, *, design: Record | str | None = None
    ) -> Identification:
        """Take in the recording of a run.

        Parameters
        ----------
        campaign : Record or str
            The campaign or its identifier.
        measurement : Record or str
            The recording or its identifier.
        design : Record or str, optional
            The motion that was made; by default, the last one that was asked for.

        Returns
        -------
        Identification
            The model from all runs so far, whose job is queued; see `wait`.
        """
        body = {
            "measurement_id": get_identifier(measurement),
            "design_id": None if design is None else get_identifier(design),
        }
        path = f"{self.path}/{get_identifier(campaign)}/tell"
        return Identification(self._transport, self._transport.post(path, dict, body))
