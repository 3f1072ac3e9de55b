"""ROS JointTrajectory, YAML and JSON."""

from __future__ import annotations

from machopt.programs.maker_contract import ProgramLanguage

LANGUAGES = (
    ProgramLanguage(
        package=__package__,
        name="ROS JointTrajectory",
        dialect="ros",
        pattern=r'^"?joint_names"?\s*:|^\s*\{.*"joint_names"\s*:',
        reader="reader:read_ros",
        priority=60,  # JSON tables may hold joint_names
        uses_urdf_joints=True,
        has_zones=False,
        external_order="cell",
        external_in_si=True,
    ),
)
