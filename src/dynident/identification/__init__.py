"""The strategies: from recordings to an identified model."""

from dynident.identification.again import reidentify
from dynident.identification.choices import IdentificationChoices
from dynident.identification.current_units import CurrentModel, identify_currents
from dynident.identification.drive_gains import DriveGains, PayloadEstimate, identify_gains, payload_mass
from dynident.identification.identify import extend, identify, identify_model
from dynident.identification.removing import remove
from dynident.identification.result import Identification, IdentifiedParameter
from dynident.identification.standard import StandardParameters
from dynident.identification.storage import from_bytes, to_bytes
from dynident.identification.weighing import PayloadVerdict, payload_from_pair

__all__ = [
    "CurrentModel",
    "DriveGains",
    "Identification",
    "IdentificationChoices",
    "IdentifiedParameter",
    "PayloadEstimate",
    "PayloadVerdict",
    "StandardParameters",
    "extend",
    "from_bytes",
    "identify",
    "identify_currents",
    "identify_gains",
    "identify_model",
    "payload_from_pair",
    "payload_mass",
    "reidentify",
    "remove",
    "to_bytes",
]
