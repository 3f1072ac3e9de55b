"""What moves in a cell, within which limits, and where it stands."""

from __future__ import annotations

from dataclasses import dataclass

from machopt.arrays import Array
from machopt.domain.cell import JointLimits, Mimic
from machopt.formats.cell_schema import CellKeys
from machopt.formats.chain import Chain, read_chain, read_change, read_home, read_limits
from machopt.formats.linkage import SideFollower, find_side_followers, followers, narrowed
from machopt.formats.plausible import check_arm, check_limits, reach
from machopt.formats.urdf import Urdf
from machopt.formats.yamlstrict import Document


@dataclass(frozen=True, kw_only=True)
class Joints:
    """The arm's joints, then the external ones; in SI."""

    chain: Chain
    limits: JointLimits
    mimics: tuple[Mimic, ...]
    side: tuple[SideFollower, ...]  # whose bodies are left out
    home: Array
    change: Array | None  # where tools are changed
    tightened: tuple[str, ...]  # limits that followers narrow, in words
    reach: float  # m, of the arm; 0 where it is not known

    @property
    def sliding(self) -> float:
        """How far (m) sliding joints go, all together."""
        slides = [i for i, j in enumerate(self.chain.moving) if j.kind == "prismatic"]
        return sum(float(self.limits.upper[i] - self.limits.lower[i]) for i in slides)


def read_joints(urdf: Urdf, keys: CellKeys, document: Document, warnings: list[str], *, any_chain: bool) -> Joints:
    """Chain, limits and places of a cell, each held against what an arm can be.

    Raises:
        InputError: names what cannot be.
    """
    chain = read_chain(urdf, keys, document, any_chain=any_chain)
    far = reach(urdf, keys, chain)
    check_arm(urdf, chain, far, document)
    limits = read_limits(chain, keys, document, warnings)
    ways = (*urdf.chain(keys.robot.flange_link), *urdf.chain(keys.workpiece.link if keys.workpiece else ""))
    side = find_side_followers(urdf, chain.arm, chain.external, ways)
    mimics = followers(urdf, chain.arm, chain.external, side)
    limits, tightened = narrowed(limits, urdf, chain.moving, mimics, side)
    check_limits(keys, chain, urdf, document, warnings)
    return Joints(
        chain=chain,
        limits=limits,
        mimics=mimics,
        side=side,
        home=read_home(chain, limits, keys, document),
        change=read_change(chain, limits, keys, document),
        tightened=tightened,
        reach=far,
    )
