"""KUKA programs by their old door; :mod:`machopt.formats.posts` writes for every maker."""

from __future__ import annotations

from pathlib import Path

from machopt.domain.program import LIN, PTP, Controller, JointMap, RobotProgram
from machopt.formats.posts import program_name, write_program

__all__ = ["LIN", "PTP", "JointMap", "RobotProgram", "krl_name", "write_krl"]


def write_krl(
    folder: Path, name: str, program: RobotProgram, *, joint_map: JointMap | None = None
) -> tuple[Path, Path]:  # fmt: skip
    """Write ``name.src`` and ``name.dat`` into ``folder`` and return their paths.

    Raises:
        InputError: KRL cannot have a module of that name.
    """
    src, dat = write_program(folder, name, program, "krl", Controller(joint_map=joint_map))
    return src, dat


def krl_name(text: str) -> str:
    """The nearest name KRL takes for ``text``."""
    return program_name(text, "krl")
