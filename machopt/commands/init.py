"""``machopt init``: a valid cell folder from a robot's URDF or xacro file."""

from __future__ import annotations

from machopt.cell.cell_reader import load_cell
from machopt.cell.urdf import read_standalone_description
from machopt.cell_setup.template.cell_draft import aim_tool, draft_cell
from machopt.cell_setup.template.cell_text import estimate_joint_stiffness, format_stiffness_yaml
from machopt.cell_setup.template.init_request import InitRequest
from machopt.cell_setup.template.init_result import InitResult
from machopt.cell_setup.template.robot_files import (
    copy_file,
    copy_meshes,
    copy_robot,
    create_cell_folder,
    restore_user_paths_in_errors,
)
from machopt.cell_setup.workpiece_placement import find_flange_direction
from machopt.commands.init_advice import find_arm_or_advise, load_solvable_robot
from machopt.commands.init_plan_data import complete_for_plan, write_cell_files
from machopt.input_files.json_schemas import format_schema_name, render_schema
from machopt.kinematics.urdf_loading import load_robot


def run_init(request: InitRequest) -> InitResult:
    """Write a new cell.

    Args:
        request: The validated request.

    Raises:
        InputError: the robot cannot be read or is no six-axis arm, an option is wrong, or the folder is taken.
    """
    description = read_standalone_description(
        request.robot, request.packages, request.xacro_args, allow_external=request.allow_external
    )
    links = find_arm_or_advise(request, description, run_init)
    span = sum(j.offset for j in description.urdf.chain(links.flange_link) if j not in links.external)
    new, guesses = draft_cell(request, description.urdf, links, span)
    with create_cell_folder(request.out) as folder, restore_user_paths_in_errors(folder, request):
        notes = copy_robot(description, folder, request.packages, span)
        copy_meshes(request, folder)
        for schema in ("cell.yaml", "stiffness.yaml"):
            (folder / "schemas").mkdir(exist_ok=True)
            (folder / "schemas" / format_schema_name(schema)).write_text(render_schema(schema), encoding="utf-8")
        if request.stiffness is not None:
            copy_file(request.stiffness, folder / "stiffness.yaml")
        else:
            text = format_stiffness_yaml(estimate_joint_stiffness(span, len(links.arm)), span=span)
            (folder / "stiffness.yaml").write_text(text, encoding="utf-8")
            guesses += ("stiffness.yaml is estimated from the arm's size; measure it (plan-poses, identify)",)
        planned = len(links.arm) == 6
        cell = write_cell_files(folder, new, planned)
        robot = load_solvable_robot(cell) if planned else load_robot(cell)
        new, warnings = aim_tool(new, request, find_flange_direction(robot), span)
        cell = write_cell_files(folder, new, planned)
        guesses += warnings
        if planned:
            guesses += complete_for_plan(folder, new, request, cell, robot, span)
        else:
            guesses += (f"the arm has {len(links.arm)} joints: identify and diagnose take it; a plan needs six",)
    return InitResult(load_cell(request.out, any_chain=not planned), request.out, guesses, notes)
