"""All parameters from all data: one system of equations (§12.3.3 i, §12.4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.identification.methods.bases import Strategy

if TYPE_CHECKING:
    from dynident.identification.choices import IdentificationChoices
    from dynident.identification.equations.data import Data
    from dynident.identification.fit import Fit
    from dynident.regressors.model import Model


@dataclass(frozen=True)
class AllAtOnce(Strategy):
    """All parameters from all data: one system of equations (§12.3.3 i, §12.4)."""

    name = "global"
    label = "all at once"
    words = "All parameters from all data. The usual choice."
    brief = "all at once"
    place = 1
    from_reduced = True
    at_once = True

    def solve(self, model: Model, choices: IdentificationChoices, data: Data) -> Fit:
        """Solve the data part by part."""
        from dynident.identification.estimators.by_name import estimate
        from dynident.identification.prior.prior import prior_of, with_prior_said

        return with_prior_said(model, data, estimate(model, choices, data, prior_of(model, choices)), choices)
