"""The strategies: from recordings to an identified model."""

from dynident.identification.choices import IdentificationChoices
from dynident.identification.drive_gains import DriveGains, PayloadEstimate, identify_gains, payload_mass
from dynident.identification.identify import extend, identify, identify_model
from dynident.identification.removing import remove
from dynident.identification.result import Identification, IdentifiedParameter
from dynident.identification.storage import from_bytes, to_bytes

__all__ = [
    "DriveGains",
    "Identification",
    "IdentificationChoices",
    "IdentifiedParameter",
    "PayloadEstimate",
    "extend",
    "from_bytes",
    "identify",
    "identify_gains",
    "identify_model",
    "payload_mass",
    "remove",
    "to_bytes",
]
