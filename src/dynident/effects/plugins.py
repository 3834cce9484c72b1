"""Effects that other distributions bring along: one Python file and one entry point each.

    [project.entry-points."dynident.effects"]
    my_effect = "my_package.my_effect:MyEffect"

The object is a subclass of `Effect` or an instance of one. An effect that cannot be loaded is left out, with a warning
that says why: somebody else's broken package must not stop an identification.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection
from importlib.metadata import EntryPoint, entry_points

from dynident.effects.effect import Effect

GROUP = "dynident.effects"


def installed_effects(taken: Collection[str]) -> tuple[Effect, ...]:
    """The effects of all installed entry points, by name; none whose id is among those `taken`."""
    found: dict[str, Effect] = {}
    for point in sorted(entry_points(group=GROUP), key=lambda item: item.name):
        effect = _loaded(point)
        if effect is None:
            continue
        if effect.id in taken or effect.id in found:
            warnings.warn(f"the effect {effect.id!r} of {point.value} is left out: that id is taken", stacklevel=2)
            continue
        found[effect.id] = effect
    return tuple(found.values())


def _loaded(point: EntryPoint) -> Effect | None:
    try:
        given = point.load()
        effect = given() if isinstance(given, type) else given
    except Exception as error:  # whatever somebody else's module raises
        warnings.warn(f"the effect {point.name!r} ({point.value}) cannot be loaded: {error}", stacklevel=3)
        return None
    if not isinstance(effect, Effect) or not all(hasattr(effect, name) for name in _NEEDED):
        warnings.warn(
            f"{point.value} is no effect: derive from dynident.effects.Effect and give it {', '.join(_NEEDED)}",
            stacklevel=3,
        )
        return None
    return effect


_NEEDED = ("id", "title", "formula", "parameters", "signature", "sources")
