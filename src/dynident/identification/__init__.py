"""Identification: from recordings and a robot to an identified model."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.lazy_loader import make_lazy_exports

if TYPE_CHECKING:
    from dynident.identification.equations.reduced_recordings import ReducedData
    from dynident.identification.identification_choices import IdentificationChoices
    from dynident.identification.identified_models.add_effects import extend
    from dynident.identification.identified_models.fit_model import identify_model
    from dynident.identification.identified_models.identification_result import (
        Estimate,
        Identification,
        IdentifiedParameter,
        LadderStep,
    )
    from dynident.identification.identified_models.identify_from_recordings import check_same_recordings, identify
    from dynident.identification.identified_models.model_files import from_bytes, to_bytes
    from dynident.identification.identified_models.remove_and_solve_again import (
        PhysicalModel,
        make_physical,
        reidentify,
        remove,
    )
    from dynident.identification.loads.current_models import CurrentModel, identify_currents
    from dynident.identification.loads.drive_gains import DriveGains, PayloadEstimate, identify_gains, payload_mass
    from dynident.identification.loads.payload_weighing import PayloadVerdict, payload_from_pair
    from dynident.identification.shape_constant_intervals import ShapeConstant
    from dynident.identification.standard_parameters import StandardParameters

__all__ = [
    "CurrentModel",
    "DriveGains",
    "Estimate",
    "Identification",
    "IdentificationChoices",
    "IdentifiedParameter",
    "LadderStep",
    "PayloadEstimate",
    "PayloadVerdict",
    "PhysicalModel",
    "ReducedData",
    "ShapeConstant",
    "StandardParameters",
    "check_same_recordings",
    "extend",
    "from_bytes",
    "identify",
    "identify_currents",
    "identify_gains",
    "identify_model",
    "make_physical",
    "payload_from_pair",
    "payload_mass",
    "reidentify",
    "remove",
    "to_bytes",
]

if not TYPE_CHECKING:
    # Requests are declared in this package, too: a reader of these must not wait for the numerics to be imported.

    __getattr__, __dir__ = make_lazy_exports(__name__)
