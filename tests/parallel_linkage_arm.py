"""Arm with a parallel linkage by a ``<mimic>`` joint: the forearm keeps its orientation while axis 2 rotates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from small_cell import urdf_text

from machopt.data_types.cell import MimicJoint

OFFSET = 0.2  # rad; no real machine has this, so that tests detect an ignored offset


def linked_urdf(multiplier: float = -1.0, offset: float = OFFSET, body: str = "", shift: str = "0 0 0") -> str:
    """Return the URDF of the small cell's arm with an additional joint ``m3`` on axis 3 that follows axis 2."""
    text = urdf_text()
    joint = (
        f'<joint name="m3" type="revolute"><parent link="link_2"/><child link="knee"/>'
        f'<origin xyz="1.150 0.0 0.0"/><axis xyz="0 -1 0"/><limit lower="-4" upper="4" velocity="0" effort="0"/>'
        f'<mimic joint="a2" multiplier="{multiplier}" offset="{offset}"/></joint><link name="knee">{body}</link>'
    )
    old = '<parent link="link_2"/><child link="link_3"/><origin xyz="1.15 0.0 0.0"'
    assert old in text
    new = f'<parent link="knee"/><child link="link_3"/><origin xyz="{shift}"'
    return text.replace(old, new).replace("</robot>", f"{joint}</robot>")


def build_mimic_joints(multiplier: float = -1.0, offset: float = OFFSET) -> tuple[MimicJoint, ...]:
    return (MimicJoint("m3", "a2", multiplier, offset),)


def expand_mimic_joints(model: Any, q: np.ndarray, follow: tuple[MimicJoint, ...]) -> np.ndarray:
    """Return pinocchio's configuration for the six driven angles: an independent implementation of mimic joints."""
    value = dict(zip((f"a{i + 1}" for i in range(6)), q, strict=True))
    for m in follow:
        value[m.joint] = m.multiplier * value[m.source] + m.offset
    return np.array([value[name] for name in list(model.names)[1:]])


def write_linkage_cell(folder: Path, text: str) -> Path:
    path = folder / "robot.urdf"
    path.write_text(text)
    return path
