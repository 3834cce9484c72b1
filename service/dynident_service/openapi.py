"""`python -m dynident_service.openapi [FILE]` writes the contract as the service has it, and the client's types."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from dynident_service import client_types
from dynident_service.app import create_app
from dynident_service.settings import Settings

FILE = Path("openapi/openapi.json")


def render_contract() -> str:
    """Return the OpenAPI document in the form in which it is committed."""
    return json.dumps(create_app(Settings()).openapi(), sort_keys=True, indent=1)


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else FILE
    target.write_text(render_contract(), encoding="utf-8")
    if target == FILE:
        document = json.loads(render_contract())
        Path(client_types.FILE).write_text(client_types.build_request_types(document), encoding="utf-8")
        for name, text in client_types.build_answer_types(document).items():
            Path(client_types.ANSWERS_FOLDER, name).write_text(text, encoding="utf-8")
        Path(client_types.DESCRIPTIONS_FILE).write_text(
            client_types.build_description_types(document), encoding="utf-8"
        )
