"""A computed design, as it is stored, back into what the science knows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from dynident.excitation import CriterionValues, Design
from dynident.excitation.criteria.baseline import Baseline
from dynident_service.adapters.answers import known
from dynident_service.adapters.designs import design_request, stored_reference
from dynident_service.models import designs as wire


def design_of(request: Mapping[str, object], result: Mapping[str, object], trajectory: Path) -> Design:
    """Take a stored design: its request, its result, and the file of its trajectory."""
    asked, told = wire.DesignRequest.model_validate(request), wire.DesignResult.model_validate(result)
    motion = stored_reference(trajectory, told.joints)
    baseline = told.baseline_values
    return known(
        Design,
        told,
        request=design_request(asked),
        t=motion.t,
        q=motion.q,
        dq=motion.dq,
        ddq=motion.ddq,
        baseline=None if baseline is None else known(Baseline, baseline, best=known(CriterionValues, baseline)),
    )
