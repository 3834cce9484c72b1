"""A computed design, as it is stored, back into what the science knows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from dynident.excitation import CriterionValues, Design, ExpectedParameter, Margin, Run
from dynident.excitation.criteria.baseline import Baseline
from dynident.excitation.limits.margins import LimitName
from dynident_service.adapters.designs import design_request, stored_reference
from dynident_service.models import designs as wire


def design_of(request: Mapping[str, Any], result: Mapping[str, Any], trajectory: Path) -> Design:
    """Take a stored design: its request, its result, and the file of its trajectory."""
    asked, told = wire.DesignRequest.model_validate(request), wire.DesignResult.model_validate(result)
    motion = stored_reference(trajectory, told.joints)
    baseline = told.baseline_values
    return Design(
        joint_names=tuple(told.joints),
        request=design_request(asked),
        t=motion.t,
        q=motion.q,
        dq=motion.dq,
        ddq=motion.ddq,
        exciting=told.exciting,
        period=told.period,
        parameter_names=tuple(told.parameter_names),
        criterion_values=_values(told.criterion_values),
        baseline=None
        if baseline is None
        else Baseline(baseline.count, _values(baseline), _number(baseline.median_condition_number)),
        margins=tuple(
            Margin(one.joint, cast(LimitName, one.limit), one.value, one.bound, _number(one.share))
            for one in told.margins
        ),
        notes=tuple(told.notes),
        expected=tuple(
            ExpectedParameter(one.name, one.effect, one.link, one.unit, one.share, one.standard_deviation)
            for one in told.expected_parameters
        ),
        runs=tuple(Run(one.label, tuple(one.joints), one.start, one.end) for one in told.runs),
    )


def _values(shown: wire.CriterionValues) -> CriterionValues:
    return CriterionValues(
        condition_number=_number(shown.condition_number),
        criterion=_number(shown.criterion),
        smallest_singular_value=_number(shown.smallest_singular_value),
        largest_singular_value=_number(shown.largest_singular_value),
        log_determinant=-float("inf") if shown.log_determinant is None else shown.log_determinant,
        trace_of_inverse=_number(shown.trace_of_inverse),
    )


def _number(value: float | None) -> float:
    """A number off the wire, where null stands for what JSON cannot say."""
    return float("inf") if value is None else value
