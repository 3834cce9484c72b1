"""Route of the catalogue of effects."""

from __future__ import annotations

from fastapi import APIRouter

from dynident_service.science_preload import hold_import_lock
from dynident_service.wire_types.shared_types import Catalogue

router = APIRouter(prefix="/v1/effects", tags=["effects"])


@router.get("")
def list_effects() -> Catalogue:
    """List all effects of the catalogue."""
    with hold_import_lock():
        from dynident_service.adapters.field_by_field import show_catalogue

    return show_catalogue()
