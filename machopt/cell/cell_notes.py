"""Notes on a cell that has been read: what its description leaves out or what was assumed."""

from __future__ import annotations

from collections.abc import Mapping

from machopt.cell.cell_schema import CellKeys
from machopt.cell.joint_reader import CellJoints
from machopt.cell.joints.joint_limits import describe_unused_motion, describe_urdf_limits
from machopt.cell.parsed_value_conversion import describe_tool_choice, describe_unused_elements
from machopt.cell.urdf import UrdfModel
from machopt.data_types.cell import Tool


def list_cell_notes(urdf: UrdfModel, keys: CellKeys, joints: CellJoints, tools: Mapping[str, Tool]) -> tuple[str, ...]:
    """List the notes on a cell.

    Args:
        urdf: The robot.
        keys: Keys of the cell file.
        joints: Joints of the cell.
        tools: Tools by name.

    Returns:
        One sentence per note.
    """
    return (
        *describe_unused_elements(urdf),
        *describe_tool_choice(tools),
        *describe_urdf_limits(joints.chain, keys),
        *joints.narrowed_limits,
        *describe_unused_motion(urdf, joints.chain, joints.limits),
    )
