from __future__ import annotations

import pytest
from support.measured_arm import BAND, EFFECTS, ROBOT, recorded

from dynident.identification import Identification, IdentificationChoices, identify
from dynident.recordings import Recording


@pytest.fixture(scope="session")
def training() -> Recording:
    return recorded(1, 20.0, "training")


@pytest.fixture(scope="session")
def unseen() -> Recording:
    return recorded(2, 12.0, "unseen")


@pytest.fixture(scope="session")
def identified(training: Recording, unseen: Recording) -> Identification:
    return identify(ROBOT, [training], [unseen], IdentificationChoices(effects=EFFECTS, preprocessing=BAND))
