"""How every family of the catalogue is hidden, at the sizes that real arms have it in.

A family is a function that draws the place and the size of its effect; `scale` is 1, or 0.25 at a quarter of the
size. Full sizes are drawn from the upper half of what is usual.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from engine import Hidden, disturbances, friction, gears, structure
from engine.temperature import Warming

from hiding.case import Placed, Truth
from hiding.site import Family, Site, as_float, as_vector


def offset(site: Site) -> Placed:
    j = site.joint()
    size = site.sign() * site.sized(0.015, 0.03) * as_float(site.effort[j])
    return Placed("offset", (j,), disturbances.Offset(j, size), (Truth(("b",), size),), equals=("coulomb_asymmetric",))


def coulomb_asymmetric(site: Site) -> Placed:
    j = site.joint()
    size = site.sign() * site.sized(0.15, 0.3) * as_float(site.drives.coulomb[j])
    physics = friction.AsymmetricCoulomb(j, size)
    return Placed("coulomb_asymmetric", (j,), physics, (Truth(("b",), size),), equals=("offset",))


def viscous_asymmetric(site: Site) -> Placed:
    j = site.joint()
    size = site.sign() * site.sized(0.15, 0.3) * as_float(site.drives.viscous[j])
    return Placed("viscous_asymmetric", (j,), friction.AsymmetricViscous(j, size), (Truth(("Fva",), size),))


def stribeck(site: Site) -> Placed:
    j = site.joint()
    size = site.sized(0.5, 0.9) * as_float(site.drives.coulomb[j])
    speed = float(np.exp(site.between(np.log(0.02), np.log(0.15)))) * as_float(site.speed[j]) / 2.5
    exponent = float(site.rng.choice([1.0, 2.0, 2.0]))
    shape = (("delta", exponent), ("vs", speed))
    return Placed("stribeck", (j,), friction.Stribeck(j, size, speed, exponent), (Truth(("Fst",), size),), shape=shape)


def viscous_nonlinear(site: Site) -> Placed:
    j = site.joint()
    power = float(site.rng.choice([2.0, 3.0, 0.5]))
    size = site.sized(0.05, 0.10) * as_float(site.effort[j]) / as_float(0.7 * site.speed[j]) ** power
    physics = friction.PowerViscous(j, size, power)
    return Placed("viscous_nonlinear", (j,), physics, (Truth(("Fvn",), size),), shape=(("p", power),))


def load_dependent_friction(site: Site) -> Placed:
    j, share = site.loaded(), site.sized(0.06, 0.12)
    # Mostly dry; sometimes a part that grows with the speed.
    viscous = 0.5 * share / as_float(site.speed[j]) if site.rng.random() < 0.25 else 0.0
    truths = (Truth(("cl",), share),) if viscous == 0.0 else ()
    return Placed("load_dependent_friction", (j,), friction.LoadFriction(j, share, viscous), truths)


def temperature_friction(site: Site) -> Placed:
    j, share = site.joint(), -site.sized(0.02, 0.04)
    warming = Warming(site.between(18, 26), site.between(15, 25), 900.0, _warmth(site, 900.0, (0.05, 0.85, 0.4)))
    viscous, coulomb = share * as_float(site.drives.viscous[j]), 0.3 * share * as_float(site.drives.coulomb[j])
    physics = friction.TemperatureFriction(j, viscous, coulomb, warming)
    return Placed("temperature_friction", (j,), physics, (Truth(("Fvt",), viscous), Truth(("Fct",), coulomb)))


def _warmth(site: Site, time: float, sittings: Sequence[float]) -> tuple[float, ...]:
    """The share of its warmth that every run starts with, from what the sittings start with; it goes on in between."""
    begins = [min(take.start for take in site.session if take.sitting == k) for k in range(len(sittings))]
    return tuple(
        as_float(1 - (1 - sittings[take.sitting]) * np.exp(-(take.start - begins[take.sitting]) / time))
        for take in site.session
    )


def warm_up_friction(site: Site) -> Placed:
    j, share = site.joint(), site.sized(0.4, 0.8)
    viscous, coulomb = share * as_float(site.drives.viscous[j]), 0.3 * share * as_float(site.drives.coulomb[j])
    time = site.between(1800.0, 3600.0)
    physics = friction.WarmUpFriction(j, viscous, coulomb, time)
    truths = (Truth(("Fvw",), viscous), Truth(("Fcw",), coulomb))
    return Placed("warm_up_friction", (j,), physics, truths, shape=(("Tw", time),))


def torque_ripple(site: Site) -> Placed:
    j = site.joint(turning=True)
    size = site.sized(0.01, 0.02) * as_float(site.effort[j])
    cycles = float(np.exp(site.between(np.log(5.0), np.log(40.0))))
    physics = structure.Ripple(j, (size,), (cycles,), (site.between(0, 6.28),))
    return Placed("torque_ripple", (j,), physics, (Truth(("Ac", "As"), size),), shape=(("k", cycles),))


def position_dependent_friction(site: Site) -> Placed:
    j, share, cycles = site.joint(turning=True), site.sized(0.25, 0.5), float(site.rng.choice([1.0, 2.0]))
    size = share * as_float(site.drives.coulomb[j])
    physics = friction.PositionFriction(j, share, cycles, site.between(0, 6.28))
    return Placed("position_dependent_friction", (j,), physics, (Truth(("Fpc", "Fps"), size),), shape=(("k", cycles),))


def presliding(site: Site) -> Placed:
    j = site.joint(turning=True)
    slip = site.scale * float(np.exp(site.between(np.log(4e-3), np.log(3e-2))))
    if site.rng.random() < 0.5:
        size = as_float(site.drives.coulomb[j])
        shape = (("d0", slip), ("law", -1.0))
        return Placed("presliding", (j,), friction.Dahl(j, slip), (Truth(("Fz",), size),), shape=shape)
    slips, shares = (0.3 * slip, slip, 2.5 * slip), (0.3, 0.45, 0.25)
    return Placed("presliding", (j,), friction.MaxwellSlip(j, slips, shares))


def backlash(site: Site) -> Placed:
    j, gap = site.loaded(), site.sized(1.5e-3, 3e-3)
    width = 0.02 * as_float(site.effort[j])
    physics: Hidden = gears.Backlash(j, gap, 0.1 * as_float(site.drives.viscous[j]))
    if site.rng.random() < 0.5:
        physics = gears.Sag(j, gap=gap, width=width)
    return Placed("backlash", (j,), physics, (Truth(("bl",), gap, signed=False),))


def joint_elasticity(site: Site) -> Placed:
    j = site.loaded()
    stiffness = site.between(50.0, 80.0) / site.scale * as_float(site.effort[j])
    physics = gears.SoftJoint(j, stiffness, 0.002 * stiffness)
    return Placed("joint_elasticity", (j,), physics, (Truth(("Ce",), 1 / stiffness, signed=False),))


def joint_spring(site: Site) -> Placed:
    j = site.joint()
    stiffness = site.sized(0.015, 0.03) * as_float(site.effort[j])
    physics = structure.Spring(j, stiffness, site.between(-0.8, 0.8))
    return Placed("joint_spring", (j,), physics, (Truth(("ks",), stiffness),))


def gravity_compensator(site: Site) -> Placed:
    share = site.sized(0.25, 0.5)
    a, b, length = site.between(0.25, 0.4), site.between(0.15, 0.25), site.between(0.1, 0.2)
    x = np.linspace(0, np.pi, 50)
    spring = np.sqrt(a**2 + b**2 + 2 * a * b * np.cos(x))
    largest = np.max(np.abs(a * b * np.sin(x) * (spring - length) / spring))
    stiffness = share * as_float(site.load[1]) / float(largest)
    low, high = site.robot.joints[1].limits.position or (-3.0, 3.0)
    opposite = (low + high) / 2 + site.between(-0.8, 0.8)
    return Placed(
        "gravity_compensator",
        (1,),
        structure.Compensator(1, stiffness, a, b, length, opposite),
        (Truth(("kab",), stiffness * a * b, signed=False),),
        shape=(("phi", opposite), ("r", min(a, b) / max(a, b))),
    )


def base_tilt(site: Site) -> Placed:
    angle, heading = np.radians(site.sized(1.5, 3.0)), site.between(0, 6.28)
    about_x, about_y = float(angle * np.cos(heading)), float(angle * np.sin(heading))
    lean = float(np.linalg.norm(site.robot.gravity) * np.sin(angle))
    return Placed("base_tilt", (), structure.Tilt(about_x, about_y), (Truth(("gx", "gy"), lean),))


def payload(site: Site) -> Placed:
    # What a wrist of this size would carry: 0.6 to 1 kg on an arm of some 18 kg.
    assert site.robot.inertias is not None
    mass = site.sized(0.6, 1.0) * float(site.robot.inertias[:, 9].sum()) / 18.0
    centre = (site.between(-0.03, 0.03), site.between(-0.03, 0.03), site.between(0.05, 0.12))
    return Placed("payload", (), structure.Payload(mass, centre, 0.04, site.runs_of(1)), (Truth(("Mp",), mass),))


def transmission_coupling(site: Site) -> Placed:
    joints = [j for j in range(1, site.robot.n - 1) if site.turns(j) and site.turns(j + 1)]
    # Where it is found: in the wrist.
    j = int(site.rng.choice(joints[-3:]))
    share, least = site.sized(0.02, 0.04), float(min(site.effort[j], site.effort[j + 1]))
    physics = structure.Coupling(
        j, site.sign(), 0.006 * 0.3 * site.scale * least, share * least / as_float(site.speed[j]), share * least
    )
    truths = (Truth(("Fcm",), physics.coulomb), Truth(("Fvm",), physics.viscous))
    return Placed("transmission_coupling", (j, j + 1), physics, truths, shape=(("side", physics.side),))


def rotor_coupling(site: Site) -> Placed:
    # Where the axis is not at right angles to all that carry it; belts rather than gears.
    j = int(site.rng.choice([j for j in (2, 3) if site.turns(j)]))
    ratio = site.between(6.0, 12.0) / site.scale
    return Placed(
        "rotor_coupling", (j,), structure.Rotor(j, ratio), (Truth(("NJ",), as_float(site.drives.rotor[j]) / ratio),)
    )


def drive_gain_error(site: Site) -> Placed:
    j, share = site.loaded(before_last=2), site.sign() * site.sized(0.05, 0.10)
    return Placed("drive_gain_error", (j,), disturbances.GainError(j, share), (Truth(("eps",), share),))


def drive_gain_saturation(site: Site) -> Placed:
    j, share = site.loaded(), -site.sized(0.08, 0.15)
    peak = 1.2 * as_float(site.load[j])
    physics = disturbances.Saturation(j, share, peak)
    return Placed("drive_gain_saturation", (j,), physics, (Truth(("sat",), share / peak),))


def torque_delay(site: Site) -> Placed:
    time = site.sized(6e-3, 15e-3)
    return Placed("torque_delay", (), disturbances.Delay(time), (Truth(("delay",), time),))


def encoder_zero_error(site: Site) -> Placed:
    j, angle = site.loaded(before_last=2), site.sign() * np.radians(site.sized(1.5, 3.0))
    return Placed(
        "encoder_zero_error",
        (j,),
        disturbances.ZeroError(j, float(angle)),
        (Truth(("dq0",), -float(angle), signed=False),),
    )


def kinematic_error(site: Site) -> Placed:
    j = int(site.rng.integers(2, site.robot.n - 2))
    direction = site.rng.standard_normal(3)
    shift = site.sized(0.010, 0.020) * direction / np.linalg.norm(direction)
    return Placed(
        "kinematic_error", (j,), structure.Displaced(j, (as_float(shift[0]), as_float(shift[1]), as_float(shift[2])))
    )


def external_contact(site: Site) -> Placed:
    force = site.rng.standard_normal(3)
    # A push that the second joint feels as a tenth or two of its load.
    force *= site.sized(0.10, 0.25) * as_float(site.load[1]) / 0.7 / np.linalg.norm(force)
    begin = site.between(0.2, 0.55) * site.length
    physics = disturbances.Contact(
        (as_float(force[0]), as_float(force[1]), as_float(force[2])),
        (0.0, 0.0, 0.1),
        (int(site.rng.choice(site.runs_of(1))),),
        begin,
        begin + site.between(1.5, 3.0),
    )
    return Placed("external_contact", (), physics)


def base_vibration(site: Site) -> Placed:
    direction = site.rng.standard_normal(3)
    shake = site.sized(0.25, 0.5) * direction / np.linalg.norm(direction)
    frequency = site.between(2.5, 6.0)
    # What shakes the base does not wait for the next run; but nobody's clock is so good that phases stay.
    sittings = [0.4] * 3 if site.rng.random() < 0.5 else [0.4, site.between(0, 6.28), site.between(0, 6.28)]
    phases = tuple(sittings[take.sitting % len(sittings)] for take in site.session)
    physics = disturbances.Vibration(as_vector(shake), frequency, phases)
    amplitude = float(np.linalg.norm(shake))
    names = ("axc", "axs", "ayc", "ays", "azc", "azs")
    truths = (Truth(names, amplitude),) if len(set(phases)) == 1 else ()
    return Placed("base_vibration", (), physics, truths, shape=(("f", frequency),))


def cable_force(site: Site) -> Placed:
    joints = [j for j in range(site.robot.n - 3) if site.turns(j + 1) and site.turns(j + 2)]
    j = int(site.rng.choice(joints[:3]))
    lever = 0.08
    needed = site.sized(0.04, 0.08) * float(max(site.load[j + 1], site.load[j + 2]))
    away = site.robot.joints[j + 2].placement[:3, 3] + site.robot.joints[j + 1].placement[:3, 3]
    length = 0.6 * float(np.linalg.norm(away)) + 0.02
    near, far = (lever, lever, 0.0), (lever, 0.0, lever)
    physics = structure.Cable(j, j + 2, needed / lever / 0.15, length, near, far)
    return Placed("cable_force", (j + 1, j + 2), physics)


FAMILIES: dict[str, Family] = {
    family.__name__: family
    for family in (
        offset, coulomb_asymmetric, viscous_asymmetric, stribeck, viscous_nonlinear, load_dependent_friction,
        temperature_friction, warm_up_friction, torque_ripple, position_dependent_friction, presliding, backlash,
        joint_elasticity, joint_spring, gravity_compensator, base_tilt, payload, transmission_coupling, rotor_coupling,
        drive_gain_error, drive_gain_saturation, torque_delay, encoder_zero_error, kinematic_error, external_contact,
        base_vibration, cable_force,
    )
}  # fmt: skip
