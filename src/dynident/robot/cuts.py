"""Read the closed loops of a robot document: two frames that coincide where the loop was cut open.

A list of objects::

    [{"name": "rod", "kind": "planar",
      "between": [{"joint": "lever", "at": [0.4, 0, 0]}, {"joint": "elbow", "at": [-0.2, 0, 0]}]}]

======================  ================================================================================================
name                    of the loop, for messages; `loop<k>` by default
kind                    planar: a pin, the origins coincide in the xy plane of the first frame (2 equations); point: a
                        ball joint, the origins coincide (3); full: the frames coincide (6)
between                 the two frames: `joint` is the joint of the table that carries it, or "base"; `at` its origin in
                        that joint's frame (m); `rpy` its rotation, about x, then y, then z (rad), none by default
======================  ================================================================================================
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from dynident.errors import DynidentError
from dynident.robot.cut_joints import EQUATIONS, FrameOnJoint, Loop, LoopKind
from dynident.robot.json_fields import expect_mapping, expect_numbers, expect_text
from dynident.robot.model import Robot
from dynident.robot.pointers import join_names, make_pointer

_BASE_NAME = "base"


def read_loops(value: object, tree: Robot, at: str, title: str) -> tuple[Loop, ...]:
    """Return the loops of a document, between joints of the tree.

    Parameters
    ----------
    value : object
        JSON value of the field `loops`.
    tree : Robot
        The tree that is left when all loops are cut open.
    at : str
        JSON pointer to the field.
    title : str
        Title of errors.

    Raises
    ------
    DynidentError
        With the pointer to the field that cannot be used.
    """
    if not isinstance(value, (list, tuple)):
        raise DynidentError("Expected a list of closed loops.", pointer=at, title=title)
    return tuple(
        _read_loop(item, index, tree, make_pointer(index, within=at), title) for index, item in enumerate(value)
    )


def _read_loop(item: object, index: int, tree: Robot, at: str, title: str) -> Loop:
    fields = expect_mapping(item, ("name", "kind", "between"), at, title)
    name = expect_text(fields.get("name", f"loop{index + 1}"), f"{at}/name", title)
    kinds: dict[str, LoopKind] = {"planar": "planar", "point": "point", "full": "full"}
    kind = fields.get("kind")
    if not isinstance(kind, str) or kind not in kinds:
        raise DynidentError(f"Expected {join_names(EQUATIONS)}.", pointer=f"{at}/kind", title=title)
    between = fields.get("between")
    if not isinstance(between, (list, tuple)) or len(between) != 2:
        raise DynidentError("Expected the two frames that coincide.", pointer=f"{at}/between", title=title)
    first, second = (
        _read_end(fields_of_end, tree, f"{at}/between/{k}", title) for k, fields_of_end in enumerate(between)
    )
    if first.joint == second.joint:
        detail = f"Both frames of loop '{name}' are on the same body, so they cannot close anything."
        raise DynidentError(detail, pointer=f"{at}/between", title=title)
    return Loop(name, kinds[kind], (first, second), at)


def _read_end(item: object, tree: Robot, at: str, title: str) -> FrameOnJoint:
    fields = expect_mapping(item, ("joint", "at", "rpy"), at, title)
    name = fields.get("joint")
    if name != _BASE_NAME and name not in tree.joint_names:
        detail = f"There is no moving joint {name!r}; expected {_BASE_NAME} or one of {join_names(tree.joint_names)}."
        raise DynidentError(detail, pointer=f"{at}/joint", title=title)
    frame = np.eye(4)
    frame[:3, 3] = expect_numbers(fields.get("at", [0.0, 0.0, 0.0]), 3, f"{at}/at", title)
    if "rpy" in fields:
        frame[:3, :3] = pin.rpy.rpyToMatrix(np.array(expect_numbers(fields["rpy"], 3, f"{at}/rpy", title)))
    return FrameOnJoint(-1 if name == _BASE_NAME else tree.joint_names.index(str(name)), frame)
