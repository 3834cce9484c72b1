from __future__ import annotations

from pathlib import Path

from dynident_service.openapi import contract

FILE = Path(__file__).parents[2] / "openapi" / "openapi.json"


def test_the_committed_contract_is_what_the_service_does() -> None:
    assert FILE.read_text(encoding="utf-8") == contract(), "run `python -m dynident_service.openapi`"
