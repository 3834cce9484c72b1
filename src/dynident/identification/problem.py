"""What an estimator solves."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.estimation import CovarianceName, Information
from dynident.identification.asked import Trust
from dynident.identification.choices import IdentificationChoices
from dynident.identification.equations.data import Data
from dynident.identification.prior.prior import prior_of
from dynident.regressors.model import Model


@dataclass(frozen=True, eq=False)
class Problem:
    """Equations of data in the columns of a model, and what is known beside them.

    `known` is what is known of the parameters that the equations of the data are in, None where that is nothing;
    `covariance` what of the residuals is taken to be correlated. `trust` in the description decides, for estimators
    that look for standard parameters, what data and `known` leave open.
    """

    model: Model
    data: Data
    known: Information | None
    covariance: CovarianceName
    trust: Trust

    @classmethod
    def of(cls, model: Model, choices: IdentificationChoices, data: Data) -> Problem:
        """All parameters from all data, with what the chosen prior says of them.

        Raises
        ------
        DynidentError
            Where the description has nothing that the prior could believe.
        """
        trust = choices.trust
        return cls(model, data, prior_of(model, trust), choices.covariance, trust)
