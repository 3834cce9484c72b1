"""The strategies: from recordings to an identified model."""

from dynident.identification.choices import IdentificationChoices
from dynident.identification.identify import extend, identify
from dynident.identification.result import Identification, IdentifiedParameter

__all__ = ["Identification", "IdentificationChoices", "IdentifiedParameter", "extend", "identify"]
