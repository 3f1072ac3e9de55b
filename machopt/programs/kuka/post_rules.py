"""KUKA: turn T and status S of a position, as KSS reads them on PTP (LIN ignores both).

Documents disagree; this reading agrees with points recorded on robots, such as S 2,T 35 and S 6,T 50:

* T, bit i: axis i+1 is below 0°.
* S, bit 0: the wrist root point lies behind A1.
* S, bit 1: the elbow is up (A3 above the angle at which the arm is stretched).
* S, bit 2: A5 is below 0°.

Bits 0 and 1 come from the arm's geometry; where it has no wrist root, S is left out, never guessed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.programs.writing.external_axes import build_external_fields, list_driven_axes
from machopt.programs.writing.maker_rules import MakerRules
from machopt.programs.writing.template_fields import PostJob
from machopt.programs.writing.template_language import TemplateValue

PRINTED = 5  # decimals of axis angles: a bit must agree with the printed number


def compute_turn_bits(axes_deg: Array) -> NDArray[np.int64]:
    """Compute the turn bits T: bit i is set where axis i+1 is below 0°.

    Args:
        axes_deg: Axes (..., 6) in controller degrees.

    Returns:
        T (...,).
    """
    return np.asarray((np.round(axes_deg, PRINTED) < 0.0) @ (1 << np.arange(6)), dtype=np.int64)


def compute_status_bits(axes_deg: Array, behind: NDArray[np.bool_], elbow_up: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Compute the status bits S; the module docstring gives the rule.

    Args:
        axes_deg: Axes (..., 6) in controller degrees.
        behind: Whether the wrist root lies behind axis 1 (...,).
        elbow_up: Whether bit 1 (elbow) is set (...,).

    Returns:
        S (...,).
    """
    flip = np.round(np.asarray(axes_deg)[..., 4], PRINTED) < 0.0
    return np.asarray(behind.astype(np.int64) | elbow_up.astype(np.int64) << 1 | flip.astype(np.int64) << 2)


def _compute_status(job: PostJob) -> Array | NDArray[np.int64]:
    p = job.program
    if p.wrist_behind is None or p.elbow_up is None:
        return np.full(len(p), np.nan)
    return compute_status_bits(job.axes_deg, p.wrist_behind, p.elbow_up)


def _list_notes(job: PostJob, used: frozenset[str]) -> Sequence[str]:
    notes, c = ["lengths mm, angles deg, $VEL.CP m/s"], job.controller
    if "status" in used and job.program.wrist_behind is None:
        notes.append("S is left out: the arm's posture is not known (LIN does not read it)")
    if np.isfinite(job.program.tool_mass):
        notes.append("$LOAD holds mass and centre of mass of the cell's tool; its inertia is not known and stands as 0")
    rails = [d for d in list_driven_axes(job.program, job.controller) if not d.axis.carries_part]
    if rails:
        axes = ", ".join(f"E{d.number}" for d in rails)
        notes.append(f"$ROBROOT rides on {axes}: its $ERSYSROOT and coupling in the machine data must say so")
    stored = [f"BASE_DATA[{c.base_number}] what MO_BASE says"] if c.base_number is not None else []
    stored += [f"TOOL_DATA[{c.tool_number}] what MO_TOOL says"] if c.tool_number is not None else []
    if stored:
        notes.append(f"to be stored in the controller: {', '.join(stored)} (at the end of the .dat)")
    notes.append("first run in T1")
    return notes


def _list_assumptions(job: PostJob, used: frozenset[str]) -> Sequence[str]:
    if job.program.T_carrier_workpiece is not None:
        return []
    return ["$ROBROOT is zero; where it is not, shift MO_BASE"] if job.controller.T_base_root is None else []


def _list_base_values(job: PostJob) -> Mapping[str, TemplateValue]:
    """What $BASE is set to: a frame in the robot root, in WORLD, or in the flange of an external kinematic (EK)."""
    number = job.controller.base_number
    frame = "MO_BASE" if number is None else f"BASE_DATA[{number}]"
    machine = build_external_fields(job.program, job.controller)["part_machine"]
    if job.program.T_carrier_workpiece is None:
        where = "the robot root"
    elif job.program.part_rides:
        definition = f"MACHINE_DEF[{machine:.0f}]"
        where, frame = f"the flange of {definition}", f"EK({definition}.ROOT,{definition}.MECH_TYPE,{frame})"
    else:
        where = "WORLD"
    return {"base_words": frame, "base_where": where}


DIALECT = MakerRules(
    columns=lambda job: {"status": lambda: _compute_status(job), "turn": lambda: compute_turn_bits(job.axes_deg)},
    values=_list_base_values,
    notes=_list_notes,
    assumptions=_list_assumptions,
    coupled=True,
    absent={"status": "the posture of this arm is not known, so there is no S; the post krl works without"},
)
