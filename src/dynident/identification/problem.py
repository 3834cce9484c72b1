"""What an estimator solves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.estimation import CovarianceName, Information, turning_weights
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
        """All parameters from all data, with what the chosen prior says of them, and rows weighed as is chosen.

        Raises
        ------
        DynidentError
            Where the description has nothing that the prior could believe.
        """
        trust = choices.trust
        known = prior_of(model, trust)
        weights = turning_weights(data.torque, known) if choices.weighs_turns else np.ones(len(data.torque.equations))
        return cls(model, data.weighing_turns(weights), known, choices.covariance, trust)
