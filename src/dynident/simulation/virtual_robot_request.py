"""The request of a simulation: effects, sensors, noise, temperature, sessions; fields and defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from dynident.effects.effect_choices import DEFAULT_EFFECTS, LINKS
from dynident.schema.fields import LARGEST_SEED, Choice, OneOf, Request, declare_field

if TYPE_CHECKING:
    from dynident.array_types import FloatArray

FeedForward = Literal["computed_torque", "gravity", "none"]
FEED_FORWARDS = OneOf(
    Choice("computed_torque", "computed torque", "The torque that the links need."),
    Choice("gravity", "gravity", "The torque that holds the links."),
    Choice("none", "none", "Nothing: the controller alone."),
)


@dataclass(frozen=True)
class ActingEffect(Request):
    """An effect of the virtual robot; of a size as found on real arms where no parameters are given.

    Parameters
    ----------
    effect : str
        Id of the effect in the catalogue.
    joints : tuple of str
        Names of the joints that it acts on; all that it may act on where there are none.
    parameters : mapping of str to float
        Values by the parameter names of the catalogue, in their units; the usual size where there are none.
    shape_parameters : mapping of str to float
        Shape constants by name; those that are left out have their defaults.
    runs : tuple of str
        Labels of the runs in which it acts: "1", "2", …; all runs where there are none.
    """

    effect: str = declare_field("Id of an effect, from GET /v1/effects")
    joints: tuple[str, ...] = declare_field("Joints on which it acts; all possible ones if none is given", default=())
    parameters: Mapping[str, float] = declare_field(
        "Parameters of the effect, by their names in the catalogue", made_by=dict
    )
    shape_parameters: Mapping[str, float] = declare_field(made_by=dict)
    runs: tuple[str, ...] = declare_field('Runs in which it acts: "1", "2", …; all if none is given', default=())


@dataclass(frozen=True)
class Warming(Request):
    """Joints that warm up with the time t of the session: T = end + (start - end) exp(-t / time_constant).

    Parameters
    ----------
    start : float
        Temperature at t = 0, degC.
    end : float
        Temperature that the joints tend to, degC.
    time_constant : float
        Time constant of the exponential, s.
    """

    start: float = declare_field("degC at t = 0", default=20.0, at_least=-273, at_most=1000)
    end: float = declare_field("degC at the end", default=45.0, at_least=-273, at_most=1000)
    time_constant: float = declare_field(
        "Time constant of the warming", default=1200.0, unit="s", at_least=1e-3, at_most=1e9
    )

    def compute_temperature(self, t: FloatArray) -> FloatArray:
        """Return the temperature in degC at given times.

        Parameters
        ----------
        t : (m,)
            Times, s.

        Returns
        -------
        (m,)
            Temperatures, degC.
        """
        # Imported here: who only declares or reads a request does not wait for numpy.
        import numpy as np

        return self.end + (self.start - self.end) * np.exp(-t / self.time_constant)


@dataclass(frozen=True)
class Sensors(Request):
    """Encoders, torque sensors and the clock of a virtual robot.

    The share of a joint's effort limit is one of the largest torque of the run where the robot has no limit. Currents
    are torque / drive gain [12.17].

    Parameters
    ----------
    sampling_rate : float
        Samples a second, Hz.
    encoder_counts : int or None
        Counts of an encoder per turn or metre; 0 or None for exact positions.
    torque_noise : float
        Standard deviation of the torque noise as a share of the effort limit.
    torque_noise_absolute : tuple of float or None
        Standard deviation of the torque noise of each joint, N m or N, in place of `torque_noise`.
    jitter : float
        Standard deviation of the sampling instants, s.
    current : bool
        Whether motor currents are recorded in place of torques.
    """

    sampling_rate: float = declare_field(default=1000.0, unit="Hz", at_least=0.1, at_most=20_000, option="-")
    encoder_counts: int | None = declare_field(
        "Encoder counts per turn or metre; 0 or null: exact", default=2**19, at_least=0, at_most=2**40
    )
    torque_noise: float = declare_field(
        "Standard deviation of the torque noise, as a share of the effort limit",
        default=0.005,
        at_least=0,
        at_most=1000,
    )
    torque_noise_absolute: tuple[float, ...] | None = declare_field(
        "Standard deviation of each joint in N m or N, instead of a share of the limit",
        default=None,
        at_least=0,
        at_most=1e9,
        most=1000,
    )
    jitter: float = declare_field(
        "Standard deviation of the sampling instants", default=0.0, unit="s", at_least=0, at_most=1
    )
    current: bool = declare_field("Record currents instead of torques; needs drive gains", default=False)


@dataclass(frozen=True, kw_only=True)
class Session(Request):
    """How often a virtual robot moves, with what between, and what is drawn.

    Parameters
    ----------
    runs : int
        Number of times that the motion is made; each run is a segment of the recording.
    pause : float
        Time between two runs, s.
    warming : Warming or None
        How the joints warm up; None for the usual warming where an effect needs a temperature.
    seed : int
        Seed of the noise and of a random motion.
    """

    runs: int = declare_field(
        "Number of repetitions of the motion, one segment each", default=1, at_least=1, at_most=100
    )
    pause: float = declare_field(
        "Pause between two runs; effects of time and temperature go on in it",
        default=60.0,
        unit="s",
        at_least=0,
        at_most=1e7,
    )
    warming: Warming | None = declare_field(
        "Records the joints' temperature; by default a typical warming if an effect needs it", default=None, option="-"
    )
    seed: int = declare_field("Seed of the noise and of a random motion", default=0, at_least=0, at_most=LARGEST_SEED)


def list_usual_effects() -> tuple[ActingEffect, ...]:
    """Return the effects that act on every joint of every arm besides its links."""
    return tuple(ActingEffect(choice.effect) for choice in DEFAULT_EFFECTS if choice.effect != LINKS.effect)


@dataclass(frozen=True, kw_only=True)
class Simulated(Session):
    """A virtual robot to be measured.

    Parameters
    ----------
    runs : int
        Number of times that the motion is made; each run is a segment of the recording.
    pause : float
        Time between two runs, s.
    warming : Warming, optional
        How the joints warm up; None for the usual warming where an effect needs a temperature.
    seed : int
        Seed of the noise and of a random motion.
    parameters : mapping of str to float
        Standard parameters by name, such as ZZ2 or Fc1; those of the description where left out.
    effects : tuple of ActingEffect
        Effects besides the links; the usual friction and rotor inertia where left out.
    noise : Sensors
        The sensors and their noise.
    sampling_rate : float or None
        Samples a second of the sensors, Hz; the rate of the trajectory where left out.
    feed_forward : FeedForward
        What the controller knows of the torque beforehand.
    """

    parameters: Mapping[str, float] = declare_field(
        "Standard parameters by name, such as ZZ2 or Fc1; the others are those of the description", made_by=dict
    )
    effects: tuple[ActingEffect, ...] = declare_field(made_by=list_usual_effects, most=1000)
    noise: Sensors = declare_field(made_by=Sensors)
    sampling_rate: float | None = declare_field(
        "Sampling rate of the sensors; that of the trajectory if not given",
        default=None,
        unit="Hz",
        at_least=0.1,
        at_most=20_000,
        option="--rate",
    )
    feed_forward: FeedForward = declare_field(
        "Torque that the controller predicts", default="computed_torque", kinds=FEED_FORWARDS
    )
