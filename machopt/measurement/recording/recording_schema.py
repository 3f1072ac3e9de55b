"""Keys of ``recording.yaml``, and file names."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from pydantic import Field

from machopt.file_formats.strict_yaml import StrictSchema

YAML_NAME, DATA_NAME = "recording.yaml", "data.csv"
UNCERTAINTY = {
    "displacement_mm": ("displacement", 1e-3),
    "rotation_mrad": ("rotation", 1e-3),
    "force_N": ("force", 1.0),
    "moment_Nm": ("moment", 1.0),
    "joint_deg": ("joint", np.pi / 180.0),
    "target_mm": ("target", 1e-3),
    "tilt_mrad": ("tilt", 1e-3),
}


class UncertaintyKeys(StrictSchema):
    displacement_mm: float | None = Field(default=None, gt=0, description="1 sigma of a coordinate in mm")
    rotation_mrad: float | None = Field(default=None, gt=0, description="1 sigma of a rotation in mrad")
    force_N: float | None = Field(default=None, ge=0, description="1 sigma of a force in N")
    moment_Nm: float | None = Field(default=None, ge=0, description="1 sigma of a moment in N·m")
    joint_deg: float | None = Field(default=None, ge=0, description="1 sigma of a joint position in degrees")
    target_mm: float | None = Field(default=None, gt=0, description="1 sigma of a coordinate of targets_mm in mm")
    tilt_mrad: float | None = Field(default=None, gt=0, description="1 sigma of an inclinometer in mrad")


class FormatKeys(StrictSchema):
    separator: str = Field(default=",", min_length=1, description='between columns: a character, "tab" or "space"')
    decimal: Literal[".", ","] = Field(default=".", description="decimal mark")
    encoding: str = Field(default="utf-8", min_length=1, description="of the text, e.g. latin-1")
    angle_unit: Literal["deg", "rad", "mrad"] | None = Field(default=None, description="of all angles of the file")
    length_unit: Literal["mm", "m", "cm", "um", "inch"] | None = Field(default=None, description="of all lengths")
    quaternion: Literal["wxyz", "xyzw"] = Field(default="wxyz", description="order of the four columns qw, qx, qy, qz")
    sheet: str | None = Field(default=None, description="of an Excel workbook; the first one if absent")
    skip_lines: int = Field(default=0, ge=0, description="lines before the header")


class JoinKeys(StrictSchema):
    files: list[str] = Field(min_length=1, description="tables whose columns are added")
    by: str = Field(default="row", min_length=1, description="row, or the name of a column that all files have")


class RecordingKeys(StrictSchema):
    machopt_recording: Literal[1] = Field(description="the format, 1")
    kind: Literal["deflection", "absolute", "motion"] = Field(description="load tests, measured poses, or motion")
    data: Any = Field(description="a data file, or a list of them")
    join: JoinKeys | None = Field(default=None, description="further files that add columns")
    columns: dict[str, str] = Field(default_factory=dict, description="our name: name of the column in the file")
    format: FormatKeys | None = Field(default=None, description="how the file is written")
    wrench_frame: Literal["base", "tool"] = Field(default="base", description="axes of forces and moments")
    displacement_frame: Literal["base", "tool"] = Field(default="base", description="axes of displacements")
    wrench_point_mm: list[float] | None = Field(
        default=None, min_length=3, max_length=3, description="x, y, z in flange of the point the moments are about"
    )
    registration: Literal["fixed", "fit"] = Field(
        default="fixed", description="whether the instrument's frame is the base or is fitted"
    )
    targets_mm: Any = Field(
        default=None, description="of each reflector its nominal place x, y, z in flange, by its name in column target"
    )
    tilt_link: Any = Field(
        default=None,
        description="link whose tilt_x_mrad, tilt_y_mrad are: its name in the URDF, or the joint that moves it",
    )
    motor_gain_Nm_per_A: Any = Field(default=None, description="of each motor, torque at its shaft per current")
    gear_ratio: Any = Field(default=None, description="of each joint, turns of its motor per turn of the joint")
    coupling_matrix: Any = Field(default=None, description="joint angles per motor angles, a row a joint")
    standard_uncertainty: UncertaintyKeys = Field(default=UncertaintyKeys(), description="of the readings, 1 sigma")
    notes: str = Field(default="", description="free text")
