"""Rows of the tables of optimize, column by column in their order; null for an empty field."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from machopt.data_types.documents.document_base import Count, DocumentModel, Known, Number, Text

MoveWord = Literal["cut", "rapid", "approach", "retract", "link"]
OF_MOVE = "what the robot does on the way to the row"
ENCODER = "by encoder, degrees; kinematics.yaml of the cell is counted in"
TURNS = "an external joint that turns, degrees"
SLIDES = "an external joint that slides"


class TrajectoryTableRow(DocumentModel):
    """One control sample of trajectory.csv."""

    time_s: Number = Field(description="since the start")
    point: Known = Field(description="fractional index along the toolpath's points; empty from and to home")
    operation: Text = Field(description="label of the CAM file; empty from and to home")
    move: MoveWord = Field(description=OF_MOVE)
    q1_deg: Number = Field(description=f"joint 1 {ENCODER}")
    q2_deg: Number = Field(description="joint 2")
    q3_deg: Number = Field(description="joint 3")
    q4_deg: Number = Field(description="joint 4")
    q5_deg: Number = Field(description="joint 5")
    q6_deg: Number = Field(description="joint 6")
    e1_mm: Number = Field(default=0.0, description=f"{SLIDES}; e1, e2, e3 in the order of external_joints")
    e1_deg: Number = Field(default=0.0, description=TURNS)
    e2_mm: Number = Field(default=0.0, description=SLIDES)
    e2_deg: Number = Field(default=0.0, description=TURNS)
    e3_mm: Number = Field(default=0.0, description=SLIDES)
    e3_deg: Number = Field(default=0.0, description=TURNS)
    gamma_deg: Known = Field(description="rotation about the tool axis as driven; empty in rapid moves and lifts")
    feed_mm_min: Known = Field(
        description="speed of the tool tip relative to the workpiece, over the step that ends there"
    )
    lead_deg: Known = Field(
        default=None, description="tilt of a ball cutter from the CAM axis towards the travel; empty in rapid moves"
    )
    side_deg: Known = Field(default=None, description="the same towards CAM axis × travel")
    tool: Text = Field(default="", description="the tool in hand, where the cell has a table of them")


class PointsTableRow(DocumentModel):
    """One point of the toolpath, a row of points.csv; it also describes the move that ends there."""

    point: Count = Field(description="index from 0")
    operation: Text = Field(description="label of the CAM file")
    move: MoveWord = Field(description=OF_MOVE)
    x_mm: Number = Field(description="tool tip in the workpiece's frame")
    y_mm: Number = Field(description="the same")
    z_mm: Number = Field(description="the same")
    i: Number = Field(description="tool axis from tip to shank, a unit vector in the workpiece's frame")
    j: Number = Field(description="the same")
    k: Number = Field(description="the same")
    gamma_deg: Known = Field(description="chosen rotation about the tool axis, as driven; empty where there is none")
    branch: Count | None = Field(description="number of the inverse kinematics' branch; empty where there is none")
    q1_deg: Known = Field(description=f"joint 1 {ENCODER}")
    q2_deg: Known = Field(description="joint 2")
    q3_deg: Known = Field(description="joint 3")
    q4_deg: Known = Field(description="joint 4")
    q5_deg: Known = Field(description="joint 5")
    q6_deg: Known = Field(description="joint 6")
    e1_mm: Known = Field(default=None, description=f"{SLIDES}; e1, e2, e3 in the order of external_joints")
    e1_deg: Known = Field(default=None, description=TURNS)
    e2_mm: Known = Field(default=None, description=SLIDES)
    e2_deg: Known = Field(default=None, description=TURNS)
    e3_mm: Known = Field(default=None, description=SLIDES)
    e3_deg: Known = Field(default=None, description=TURNS)
    k_axial_N_mm: Known = Field(description="stiffness along the tool axis, 1/(eᵀCe) with e that axis")
    k_normal_N_mm: Known = Field(description="stiffness across it")
    deflection_mm: Known = Field(description="of the tool tip under the process force")
    clearance_mm: Known = Field(description="to the nearest body")
    limit_margin_deg: Known = Field(description="to the nearest joint limit")
    singularity: Known = Field(description="least angle from a singular configuration, degrees")
    status: Text = Field(description="ok, or the class of what is wrong")
    reason: Text = Field(description="reason; where ok: that the feed is not reached; else empty")
    feed_mm_min: Known = Field(description="programmed for the whole move that ends there; empty for rapid moves")
    k_jiao_x_N_mm: Known = Field(description="index of jiao2022 along the tool axis, with fixed orientation")
    nearest_pair: Text = Field(default="", description="the two nearest bodies, where collisions are checked")
    stiffness_from: Literal["grid", "constant"] = Field(default="grid", description="where the stiffness has a grid")
    deflection_std_mm: Known = Field(default=None, description="1 sigma of the deflection, where the file knows one")
    k_axial_std_N_mm: Known = Field(default=None, description="1 sigma of the stiffness along the axis, the same")
    dwell_s: Known = Field(default=None, description="that the file waits there, where it waits anywhere")
    comp_dx_mm: Known = Field(default=None, description="added to the commanded path, in the workpiece's frame")
    comp_dy_mm: Known = Field(default=None, description="the same")
    comp_dz_mm: Known = Field(default=None, description="the same")
    lead_deg: Known = Field(
        default=None, description="tilt of a ball cutter from i, j, k towards the travel; empty where there is none"
    )
    side_deg: Known = Field(default=None, description="the same towards i, j, k × travel")
    feed_advised_mm_min: Known = Field(
        default=None, description="feed of the programs with method joint: that of the file, or the advice where lower"
    )
    ae_mm: Known = Field(default=None, description="radial depth of cut")
    ap_mm: Known = Field(default=None, description="axial depth of cut")
    phi_in_deg: Known = Field(default=None, description="start of the engagement of a tooth")
    phi_out_deg: Known = Field(default=None, description="its end")
    f_travel_N: Known = Field(
        default=None, description="mean force on the tool along travel, at the feed that the motion reaches"
    )
    f_normal_N: Known = Field(default=None, description="along tool axis × travel")
    f_axial_N: Known = Field(default=None, description="along the tool axis, + towards the shank")
    m_axial_Nm: Known = Field(default=None, description="moment about the axis, tip to shank")
    f_peak_N: Known = Field(default=None, description="largest resultant within a revolution, without dynamics")
    error_along_mm: Known = Field(
        default=None, description="predicted error along the axis at depth, + towards the shank, nominal"
    )
    error_along_lo_mm: Known = Field(default=None, description="5 % of all draws")
    error_along_hi_mm: Known = Field(default=None, description="95 % of all draws")
    error_across_mm: Known = Field(
        default=None, description="predicted error across the axis of a hole, at entry, nominal"
    )
    error_across_lo_mm: Known = Field(default=None, description="5 % of all draws")
    error_across_hi_mm: Known = Field(default=None, description="95 % of all draws")
    error_normal_mm: Known = Field(
        default=None, description="predicted error normal to the surface, + material left, nominal"
    )
    error_normal_lo_mm: Known = Field(default=None, description="5 % of all draws")
    error_normal_hi_mm: Known = Field(default=None, description="95 % of all draws")
    error_axis_deg: Known = Field(
        default=None, description="predicted angle of the axis, the larger of entry and exit, nominal"
    )
    error_axis_lo_deg: Known = Field(default=None, description="5 % of all draws")
    error_axis_hi_deg: Known = Field(default=None, description="95 % of all draws")
    tolerance_mm: Known = Field(default=None, description="tightest limit of a length, ±")
    p_in: Known = Field(default=None, description="probability that all tolerances of the point hold")
    p_in_deflection_only: Known = Field(
        default=None, description="the same of the deflection alone, where p_in is unknown"
    )
    outcome: Text = Field(default="", description="pass, marginal, fail or unknown")
    cause: Text = Field(default="", description="largest contribution to the deflection, with its share: joint:2 0.61")
    f1_Hz: Known = Field(default=None, description="lowest mode of the arm")
    a_lim_mm: Known = Field(default=None, description="axial depth of cut at which the cut becomes unstable")
    chatter: Text = Field(default="", description="stable, robot:N, spindle or unknown")
    feed_max_mm_min: Known = Field(default=None, description="largest feed that stays in tolerance")
