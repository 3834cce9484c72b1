#!/usr/bin/env python3
"""Print the first shell block of README.md after a heading, so that it is run as it is written.

.ci/readme_block.py "See it work"
"""

import re
import sys
from pathlib import Path

text = (Path(__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")
section = re.search(rf"^#+ {re.escape(sys.argv[1])}$(.*?)(?=^#+ |\Z)", text, re.MULTILINE | re.DOTALL)
block = section and re.search(r"^```sh\n(.*?)^```$", section.group(1), re.MULTILINE | re.DOTALL)
if not block:
    sys.exit(f"README.md has no shell block under the heading {sys.argv[1]!r}")
print(block.group(1), end="")
