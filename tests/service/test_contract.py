from __future__ import annotations

import json
from pathlib import Path

import pytest
from versions import older_than_locked

import dynident_client
from dynident_service.client_types import (
    ANSWERS_FOLDER,
    DESCRIPTIONS_FILE,
    answer_types,
    client_types,
    description_types,
)
from dynident_service.client_types import FILE as TYPES
from dynident_service.openapi import contract

# Older ones give the same schemas other names.
pytestmark = pytest.mark.skipif(older_than_locked("fastapi"), reason="the contract is written by a newer FastAPI")

FILE = Path(__file__).parents[2] / "openapi" / "openapi.json"


def test_the_committed_contract_is_what_the_service_does() -> None:
    assert FILE.read_text(encoding="utf-8") == contract(), "run `python -m dynident_service.openapi`"


def test_the_types_of_the_client_are_those_of_the_contract() -> None:
    # Beside an installed package there are no sources.
    written = Path(dynident_client.__file__).with_name(Path(TYPES).name).read_text(encoding="utf-8")
    assert written == client_types(json.loads(contract())), "run `python -m dynident_service.openapi`"


def test_what_the_client_says_of_robots_and_recordings_is_the_contract_s() -> None:
    written = Path(dynident_client.__file__).with_name(Path(DESCRIPTIONS_FILE).name).read_text(encoding="utf-8")
    assert written == description_types(json.loads(contract())), "run `python -m dynident_service.openapi`"


def test_what_the_client_says_of_answers_is_the_contract_s() -> None:
    folder = Path(dynident_client.__file__).with_name(Path(ANSWERS_FOLDER).name)
    written = {file.name: file.read_text(encoding="utf-8") for file in folder.glob("*.py")}
    assert written == answer_types(json.loads(contract())), "run `python -m dynident_service.openapi`"
