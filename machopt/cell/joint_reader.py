"""Joints of a cell: the moving joints, their limits and positions."""

from __future__ import annotations

from dataclasses import dataclass

from machopt.cell.cell_schema import CellKeys
from machopt.cell.joints.joint_chain import JointChain, read_chain
from machopt.cell.joints.joint_limits import read_home, read_limits, read_tool_change_position
from machopt.cell.joints.mimic_joints import OffChainMimicJoint, find_mimic_joints, find_side_followers, narrow_limits
from machopt.cell.plausibility_checks import check_arm, check_limits, estimate_reach
from machopt.cell.urdf import UrdfModel
from machopt.data_types.cell import JointLimits, MimicJoint
from machopt.file_formats.strict_yaml import YamlDocument
from machopt.numerics.array_types import Array


@dataclass(frozen=True, kw_only=True)
class CellJoints:
    """The arm's joints, then the external ones; in SI."""

    chain: JointChain
    limits: JointLimits
    mimics: tuple[MimicJoint, ...]
    side: tuple[OffChainMimicJoint, ...]  # whose bodies are left out
    home: Array
    change: Array | None  # where tools are changed
    narrowed_limits: tuple[str, ...]  # limits that followers narrow, in words
    reach: float  # m, of the arm; 0 where it is not known

    @property
    def sliding(self) -> float:
        """How far (m) sliding joints go, all together."""
        slides = [i for i, j in enumerate(self.chain.moving) if j.kind == "prismatic"]
        return sum(float(self.limits.upper[i] - self.limits.lower[i]) for i in slides)


def read_joints(
    urdf: UrdfModel, keys: CellKeys, document: YamlDocument, warnings: list[str], *, any_chain: bool
) -> CellJoints:
    """Read chain, limits and positions of a cell, each checked for plausibility.

    Args:
        urdf: The robot: links, joints, bodies and masses.
        keys: Validated keys of cell.yaml.
        document: Parsed YAML file, with the line of each key for errors.
        warnings: List that takes the warnings.
        any_chain: Whether the arm may have other than six revolute joints.

    Returns:
        The joints, SI units.

    Raises:
        InputError: names the value that is impossible.
    """
    chain = read_chain(urdf, keys, document, any_chain=any_chain)
    far = estimate_reach(urdf, keys, chain)
    check_arm(urdf, chain, far, document)
    limits = read_limits(chain, keys, document, warnings)
    ways = (*urdf.chain(keys.robot.flange_link), *urdf.chain(keys.workpiece.link if keys.workpiece else ""))
    side = find_side_followers(urdf, chain.arm, chain.external, ways)
    mimics = find_mimic_joints(urdf, chain.arm, chain.external, side)
    limits, tightened = narrow_limits(limits, urdf, chain.moving, mimics, side)
    check_limits(keys, chain, urdf, document, warnings)
    return CellJoints(
        chain=chain,
        limits=limits,
        mimics=mimics,
        side=side,
        home=read_home(chain, limits, keys, document),
        change=read_tool_change_position(chain, limits, keys, document),
        narrowed_limits=tightened,
        reach=far,
    )
