"""An arm that is too heavy for some motions."""

from __future__ import annotations

from typing import Any

from support.two_link_arm import URDF

INERTIAL = (
    '<inertial><origin xyz="0.2 0 0"/><mass value="3"/>'
    '<inertia ixx="0.01" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
)


def heavy_arm(page: Any) -> str:
    """The two-link arm with inertias, which a virtual one needs; gives its id."""
    content = URDF
    for link in ("upper", "fore"):
        content = content.replace(f'<link name="{link}"/>', f'<link name="{link}">{INERTIAL}</link>')
    body = {"name": "heavy links", "description": {"format": "urdf", "content": content}}
    return str(page.request.post("/v1/robots", data=body).json()["id"])
