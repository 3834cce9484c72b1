"""Our effects and estimators keep to what is asked of anybody's."""

from __future__ import annotations

import pytest

from dynident.effects import CATALOGUE
from dynident.identification.methods.base_classes import ESTIMATORS
from dynident.testing import check_effect, check_estimator

# It dissolves in the base parameters of three joints whose axes are upright or lie.
HIDDEN_ON_THE_TRIAL_ARM = {"rotor_coupling"}


@pytest.mark.parametrize("name", CATALOGUE)
def test_an_effect_of_the_catalogue_conforms(name: str) -> None:
    told = check_effect(CATALOGUE[name])
    assert ("too little to find" in told[-1]) == (name in HIDDEN_ON_THE_TRIAL_ARM), told


@pytest.mark.parametrize("name", ESTIMATORS.names)
def test_an_estimator_conforms(name: str) -> None:
    assert check_estimator(ESTIMATORS.get(name))
