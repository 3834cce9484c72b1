"""Which kind of experiment tells which effects apart: one table of physics."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from dynident.diagnosis.advice.kinds import EXPERIMENTS, Experiment


def _pairs(experiment: str, *pairs: tuple[str, str]) -> dict[frozenset[str], str]:
    return {frozenset(pair): experiment for pair in pairs}


PAIRS: Mapping[frozenset[str], str] = MappingProxyType(
    {
        # How friction goes with the speed.
        **_pairs(
            "constant_speeds",
            ("stribeck", "viscous_nonlinear"),
            ("stribeck", "coulomb"),
            ("stribeck", "break_away"),
            ("stribeck", "viscous"),
            ("viscous_nonlinear", "viscous"),
            ("viscous_nonlinear", "coulomb"),
            ("viscous_asymmetric", "offset"),
            ("viscous_asymmetric", "coulomb_asymmetric"),
            ("viscous_asymmetric", "viscous_nonlinear"),
        ),
        # What goes with the path travelled since a reversal.
        **_pairs(
            "reversals",
            ("presliding", "stribeck"),
            ("presliding", "coulomb"),
            ("presliding", "break_away"),
            ("presliding", "torque_delay"),
            ("presliding", "viscous_nonlinear"),
            ("presliding", "backlash"),
            ("presliding", "joint_elasticity"),
        ),
        # What goes with the position, without inertia and with both directions at every place.
        **_pairs(
            "slow_sweep",
            ("joint_spring", "offset"),
            ("joint_spring", "coulomb_asymmetric"),
            ("joint_spring", "torque_ripple"),
            ("joint_spring", "gravity_compensator"),
            ("joint_spring", "cable_force"),
            ("torque_ripple", "offset"),
            ("torque_ripple", "gravity_compensator"),
            ("torque_ripple", "position_dependent_friction"),
            ("torque_ripple", "joint_elasticity"),
            ("position_dependent_friction", "coulomb"),
            ("backlash", "joint_elasticity"),
        ),
        # What goes with the load.
        **_pairs(
            "payload",
            ("load_dependent_friction", "position_dependent_friction"),
            ("load_dependent_friction", "drive_gain_saturation"),
            ("load_dependent_friction", "drive_gain_error"),
            ("load_dependent_friction", "coulomb"),
            ("drive_gain_error", "drive_gain_saturation"),
            ("drive_gain_error", "rigid_body"),
            ("drive_gain_error", "joint_elasticity"),
            ("payload", "rigid_body"),
        ),
        # What goes with the frequency of one and the same path.
        **_pairs(
            "paces",
            ("torque_delay", "joint_elasticity"),
            ("torque_delay", "viscous"),
            ("torque_delay", "viscous_nonlinear"),
            ("torque_delay", "stribeck"),
            ("joint_elasticity", "rotor_inertia"),
            ("joint_elasticity", "encoder_zero_error"),
            ("rotor_coupling", "rigid_body"),
        ),
        **_pairs(
            "cold_and_warm",
            ("temperature_friction", "warm_up_friction"),
            ("temperature_friction", "viscous"),
            ("warm_up_friction", "viscous"),
        ),
        **_pairs(
            "repeated",
            ("external_contact", "base_vibration"),
            ("base_vibration", "torque_ripple"),
        ),
    }
)
"""The experiment that tells two effects apart; for all other pairs the one that shows the first alone."""


PLACES: Mapping[str, str] = MappingProxyType({"payload": "as_it_is"})
"""The experiment that tells two places of an effect apart."""


ALONE: Mapping[str, str] = MappingProxyType(
    {
        "rigid_body": "whole_range",
        "rotor_inertia": "whole_range",
        "coulomb": "constant_speeds",
        "viscous": "constant_speeds",
        "offset": "slow_sweep",
        "coulomb_asymmetric": "slow_sweep",
        "viscous_asymmetric": "constant_speeds",
        "stribeck": "constant_speeds",
        "viscous_nonlinear": "constant_speeds",
        "load_dependent_friction": "payload",
        "temperature_friction": "cold_and_warm",
        "warm_up_friction": "cold_and_warm",
        "torque_ripple": "slow_sweep",
        "position_dependent_friction": "slow_sweep",
        "presliding": "reversals",
        "break_away": "reversals",
        "backlash": "slow_sweep",
        "joint_elasticity": "paces",
        "joint_spring": "slow_sweep",
        "gravity_compensator": "slow_sweep",
        "base_tilt": "whole_range",
        "payload": "payload",
        "transmission_coupling": "whole_range",
        "rotor_coupling": "whole_range",
        "drive_gain_error": "payload",
        "drive_gain_saturation": "payload",
        "torque_delay": "paces",
        "encoder_zero_error": "whole_range",
        "kinematic_error": "whole_range",
        "external_contact": "repeated",
        "base_vibration": "repeated",
        "cable_force": "whole_range",
        "unknown": "repeated",
    }
)
"""The experiment that shows an effect; the motion over the whole range for effects that users added."""


def experiment_for(suspect: str, rival: str | None) -> Experiment:
    """The experiment that decides between two effects, or between two places of one, or that shows one."""
    if suspect == rival:
        return EXPERIMENTS[PLACES.get(suspect, "whole_range")]
    name = None if rival is None else PAIRS.get(frozenset((suspect, rival)))
    return EXPERIMENTS[name or ALONE.get(suspect, "whole_range")]
