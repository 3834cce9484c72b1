"""Adding effects to an identified model, and keeping it, against identifying the larger model anew.

python benchmarks/extending.py

Of every model the parameters, their standard deviations and the held-out errors are asked for.
"""

from __future__ import annotations

import numpy as np
from common import median_time, simulated_samples
from compared import compared

from dynident.effects import EffectChoice
from dynident.identification import Identification, IdentificationChoices, extend, identify, remove, to_bytes
from dynident.recordings import Preprocessing, recording_from_arrays
from dynident.robot import robot_from_library, to_pinocchio

PLAIN = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset"))
CHOICES = IdentificationChoices(PLAIN, preprocessing=Preprocessing(8.0, 8.0, 5))


def main() -> None:
    robot = robot_from_library("ur10")
    samples = [simulated_samples(to_pinocchio(robot), 4000, 100.0, seed=seed) for seed in (1, 2)]
    runs = [recording_from_arrays(s.t, s.q, s.tau, joint_names=robot.joint_names) for s in samples]
    added = (
        EffectChoice("presliding", robot.joint_names, (("d0", 0.001), ("law", -1.0))),
        EffectChoice("viscous_nonlinear", robot.joint_names[:1], (("p", 1.5),)),
    )
    model = identify(robot, runs[:1], runs[1:], CHOICES)
    grown = extend(model, added, runs[:1], runs[1:])
    whole = IdentificationChoices((*PLAIN, *added), preprocessing=CHOICES.preprocessing)
    anew = identify(robot, runs[:1], runs[1:], whole)
    assert grown.held_out is not None
    assert anew.held_out is not None
    assert np.allclose(grown.held_out.rms, anew.held_out.rms, rtol=1e-6)
    times = {
        "identify the larger model": median_time(lambda: ask(identify(robot, runs[:1], runs[1:], whole)), 9),
        "extend the smaller one": median_time(lambda: ask(extend(model, added, runs[:1], runs[1:])), 9),
        "remove the effects again": median_time(lambda: ask(remove(grown, added)), 9),
        "write the model with its ladder": median_time(lambda: to_bytes(grown), 5),
    }
    slowest = times["identify the larger model"]
    print(f"{robot.name}, two runs of {len(samples[0].t)} samples, {len(added)} effects, {len(grown.values)} in all")
    for what, seconds in times.items():
        print(f"  {what:34s} {1000 * seconds:7.1f} ms   {seconds / slowest:5.2f}")
        if seconds != slowest:
            compared(
                f"two effects, 2 x 4,000 samples x 6 joints: {what}", seconds, "identify the larger model", slowest
            )


def ask(model: Identification) -> None:
    """Ask for what a person looks at first; what nobody asks for is not computed."""
    assert model.held_out is not None
    assert len(model.parameters) == len(model.statistics.standard_deviations)


if __name__ == "__main__":
    main()
