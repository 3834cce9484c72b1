"""The strategies: from recordings to an identified model."""

from dynident.identification.choices import IdentificationChoices
from dynident.identification.identify import extend, identify, identify_model
from dynident.identification.removing import remove
from dynident.identification.result import Identification, IdentifiedParameter
from dynident.identification.storage import from_bytes, to_bytes

__all__ = [
    "Identification",
    "IdentificationChoices",
    "IdentifiedParameter",
    "extend",
    "from_bytes",
    "identify",
    "identify_model",
    "remove",
    "to_bytes",
]
