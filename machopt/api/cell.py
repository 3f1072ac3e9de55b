"""Robot cell of the Python API."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Unpack

import numpy as np

from machopt.api.error_message_translation import use_argument_names
from machopt.api.option_types import NewCellOptions
from machopt.api.request_options import build_request, convert_to_path, convert_to_paths
from machopt.cell.cell_reader import load_cell
from machopt.cell_setup.template.init_request import InitRequest
from machopt.cell_setup.validation.planning_checks import CellRemark
from machopt.commands.input_hashes import list_cell_inputs
from machopt.data_types import cell as domain
from machopt.data_types.manifest import ManifestFile
from machopt.effects.user_effects import UserModule, activate_user_effects, load_effect_files
from machopt.errors import InputError, TooManyArmJointsError
from machopt.numerics.array_types import Array


@dataclass(frozen=True)
class Cell:
    """Robot cell: arm, tool, workpiece, obstacles, limits, stiffness. :meth:`load` makes one."""

    path: Path  # cell folder or its cell.yaml, as it was given
    description: domain.Cell  # everything that was read, in SI
    allow_external: bool
    effects: tuple[UserModule, ...]  # files with effects of the user's own, run
    files: tuple[ManifestFile, ...]  # what was read, by hash

    @classmethod
    @use_argument_names()
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        stiffness: str | os.PathLike[str] | None = None,
        process: str | os.PathLike[str] | None = None,
        effects: Iterable[str | os.PathLike[str]] = (),
        allow_external: bool = False,
        for_diagnosis: bool = False,
    ) -> Cell:
        """Read a cell folder.

        Args:
            path: the cell folder, or its cell.yaml.
            stiffness: a stiffness.yaml to take in place of the one that cell.yaml names, wherever it lies. The command
                ``machopt verify`` refuses plans of such a cell as long as cell.yaml names another.
            process: a process.yaml to take in place of the one that cell.yaml names (``--process``).
            effects: Python files with effects of your own that the stiffness file holds; **runs the code in them**. All
                that is made from the cell knows them.
            allow_external: let the cell use files outside its folder.
            for_diagnosis: accept an arm of more than six joints, which identify and diagnose take and plans do not.

        Raises:
            InputError: names file, line and key, what was found and what was expected.
        """
        folder = convert_to_path(path, "cell")
        own = load_effect_files(list(convert_to_paths(effects, "effects")))
        with activate_user_effects(own):
            cell = load_cell(
                folder,
                allow_external=allow_external,
                any_chain=for_diagnosis,
                stiffness=None if stiffness is None else convert_to_path(stiffness, "stiffness"),
                process=None if process is None else convert_to_path(process, "process"),
            )
        return cls(folder, cell, allow_external, own, list_cell_inputs(cell))

    @classmethod
    @use_argument_names()
    def new(cls, robot: str | os.PathLike[str], out: str | os.PathLike[str], **options: Unpack[NewCellOptions]) -> Cell:
        """Write a new cell folder from a robot's URDF or xacro file, as ``machopt init`` does, and load it.

        What is a guess or an estimate in it says so in cell.yaml.

        Args:
            robot: URDF or xacro file.
            out: the new cell folder.
            options: as :class:`machopt.cell_setup.template.init_request.InitRequest` has them, e.g.
                ``tool_length_mm=250``,
                ``toolpath="part.nc"``, ``post="krl"``.

        Raises:
            InputError: the robot is no six-axis arm, an option is wrong, or the folder is taken.
        """
        from machopt.commands.init import run_init

        run_init(
            build_request(InitRequest, options, robot=convert_to_path(robot, "robot"), out=convert_to_path(out, "out"))
        )
        return cls.load(out)

    @use_argument_names()
    def validate(self, *, picture: str | os.PathLike[str] | None = None) -> tuple[CellRemark, ...]:
        """Everything wrong or odd about the cell as it lies in its folder, errors first: ``machopt validate``.

        Args:
            picture: an SVG file to draw it into, at home from three sides.

        Raises:
            InputError: the picture cannot be written.
        """
        from machopt.commands.validate import run_validate

        file = None if picture is None else Path(picture)
        effects = [own.file for own in self.effects]
        return run_validate(self.path, allow_external=self.allow_external, picture_file=file, effects=effects).findings

    def with_stiffness(self, file: str | os.PathLike[str]) -> Cell:
        """Return the same cell with another stiffness.yaml, e.g. the one that ``identify`` or ``diagnose`` saved.

        Args:
            file: Path of the stiffness file.

        Raises:
            InputError: the file is no stiffness file, or its values do not fit this arm.
        """
        files = [own.file for own in self.effects]
        return Cell.load(self.path, stiffness=file, effects=files, allow_external=self.allow_external)

    @property
    def name(self) -> str:
        return self.description.name

    @property
    def joints(self) -> tuple[str, ...]:
        """(J,) names of the moving joints: the arm's in chain order, then the external ones."""
        return (*self.description.arm_joints, *self.description.external_joints)

    @property
    def home(self) -> Array:
        """(J,) home position by encoder, degrees; mm for prismatic joints."""
        slides = (*(self.description.arm_prismatic or (False,) * 6), *self.description.external_prismatic)
        si = np.concatenate([self.description.home, self.description.external_home])
        return copy_read_only(np.where(slides, si * 1e3, np.degrees(si)))

    @property
    def joint_stiffness(self) -> Array | None:
        """(6,) constant joint stiffness, N·m/rad; None where the cell names no stiffness file."""
        return None if self.description.stiffness is None else copy_read_only(self.description.stiffness.joints)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the cell that are no errors."""
        return self.description.warnings

    def unchanged(self) -> Cell:
        """Return the cell if its files are still those that were read, because a result names its inputs by hash.

        Raises:
            InputError: a file has changed since.
        """
        now = {f.name: f.sha256 for f in list_cell_inputs(self.description)}
        for file in self.files:
            if now.get(file.name) != file.sha256:
                raise InputError("has changed since the cell was loaded; load it again", file=file.name)
        return self

    def __repr__(self) -> str:
        return f"<Cell {self.name!r} of {self.path}>"


def load_cell_argument(cell: Cell | str | os.PathLike[str], *, for_diagnosis: bool = False) -> Cell:
    """Return a cell; a path is loaded.

    Args:
        cell: A cell, or its path.
        for_diagnosis: Whether the arm of a path may have more than six joints.

    Raises:
        InputError: the path is no cell, or a file of the cell has changed.
    """
    if isinstance(cell, Cell):
        return cell.unchanged()
    try:
        return Cell.load(cell)
    except TooManyArmJointsError:
        if not for_diagnosis:
            raise
        return Cell.load(cell, for_diagnosis=True)


def copy_read_only(values: Array) -> Array:
    """Return a copy that cannot be changed.

    Args:
        values: Numbers of any shape.
    """
    out = np.array(values, float)
    out.setflags(write=False)
    return out
