"""A robot whose links have mesh files."""

from __future__ import annotations

import numpy as np

ARM = """
<robot name="arm">
  <link name="base"/>
  <link name="one"><collision><geometry><mesh filename="package://arm/meshes/one.stl"/></geometry></collision></link>
  <link name="two"><collision><geometry><mesh filename="package://arm/meshes/two.stl"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="one"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1" effort="100"/></joint>
  <joint name="swing" type="revolute"><parent link="one"/><child link="two"/><origin xyz="0 0 .5"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="100"/></joint>
</robot>"""


def rod(height: float = 0.4, corners: int = 5) -> bytes:
    """An upright prism as STL."""
    angle = np.arange(corners) * 2 * np.pi / corners
    rim = np.column_stack([0.05 * np.cos(angle), 0.05 * np.sin(angle), np.zeros(corners)])
    up = np.array([0.0, 0.0, height])
    faces = [[low[0], low[k], low[k + 1]] for low in (rim, rim + up) for k in range(1, corners - 1)]
    faces += [[rim[k - 1], rim[k], rim[k] + up] for k in range(corners)]
    faces += [[rim[k - 1], rim[k] + up, rim[k - 1] + up] for k in range(corners)]
    lines = ["solid rod"]
    for face in faces:
        lines += ["facet normal 0 0 1", "outer loop"]
        lines += ["vertex {:.6f} {:.6f} {:.6f}".format(*corner) for corner in face]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid rod\n"]).encode()
