"""Print the table of effects in README.md, from the catalogue: `python docs/effects_table.py`."""

from __future__ import annotations

from dynident.effects import CATALOGUE, Effect


def row(effect: Effect) -> str:
    """One effect as a row of a Markdown table."""
    formula = effect.formula.replace("|", r"\vert ")
    parameters = ", ".join(f"{spec.name} [{spec.unit}]" for spec in effect.parameters)
    return f"| `{effect.id}` | ${formula}$ | {parameters} | {effect.signature} |"


def table() -> str:
    """The whole table."""
    head = "| effect | torque that it adds | parameters | what is left in the residual without it |\n|---|---|---|---|"
    return "\n".join([head, *(row(effect) for effect in CATALOGUE.values())])


if __name__ == "__main__":
    print(table())
