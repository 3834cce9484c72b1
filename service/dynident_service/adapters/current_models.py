"""Models of currents between the contract and the science."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.identification import CurrentModel
from dynident_service.adapters.answers import shown
from dynident_service.models import current_models as wire


def describe_currents(found: Sequence[CurrentModel]) -> wire.CurrentModelsResult:
    """Describe the models of all joints for the wire."""
    return wire.CurrentModelsResult(joints=[shown(wire.CurrentModelView, one) for one in found])
