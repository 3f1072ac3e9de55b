"""Program written a second time from what was read of it: every word except the coordinates has to be the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.program_in_cell import ProgramInCell
from machopt.data_types.robot_program import LIN, RobotController, RobotProgram
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.kinematics.controller_posture import compute_controller_posture
from machopt.kinematics.urdf_loading import load_robot
from machopt.numerics.array_types import Array
from machopt.programs.maker_registry import find_language, load_checks
from machopt.programs.program_reader import ParsedProgram
from machopt.programs.program_writer import load_post, render_expected_text
from machopt.programs.writing.blend_zones import compute_blend_zones
from machopt.programs.writing.post_file import PostKeys
from machopt.programs.writing.target_insertion import ProgramTolerance
from machopt.programs.writing.template_fields import ROUNDED
from machopt.programs.writing.text_comparison import find_text_difference, find_undecodable_bytes, find_wrong_line_end
from machopt.verification.check_results import VerificationCheck, build_file_check
from machopt.verification.folder.programs.blend_zones import check_blend_zones
from machopt.verification.folder.programs.post_lookup import (
    compute_workpiece_in_base,
    get_workpiece_on_positioner,
    list_external_axes,
)


@dataclass(frozen=True, kw_only=True)
class RewrittenProgram:
    """Input of a post other than the moves."""

    cell: Cell
    toolpath: Toolpath
    out: Path
    options: PlanOptions
    tolerance: ProgramTolerance
    source: str  # what the program's head says it is from
    rapid: tuple[Array, Array] | None = None  # (M,) share and (M,) m over which joint moves may be rounded

    def check_text(
        self,
        files: Sequence[str],
        post: str | Path,
        parsed: ParsedProgram,
        stated: ProgramInCell,
        controller: RobotController,
        q: Array,
        external: Array,
    ) -> list[VerificationCheck]:
        """Compare the whole text with the post's, and its zones with the law that the post follows.

        Args:
            files: of the program, the one that is run first.
            post: what wrote it.
            parsed: the program as it was read.
            stated: the same in the cell's terms.
            controller: as the post took it.
            q: (M, 6) rad, the joints of the targets.
            external: (M, E) rad or m, where the external joints stand there.
        """
        name = files[0]
        keys = load_post(post).keys
        program = self._build_program(parsed, stated, controller, q, external)
        law = compute_blend_zones(
            program, controller.moves_per_part or keys.moves_per_part if keys.moves_per_part else None
        )
        zones, own = bool(load_post(post).list_used_fields & ROUNDED), isinstance(post, Path)
        checks = (
            []
            if stated.is_streamed
            else check_blend_zones(
                name, parsed, program, law, controller, zones=zones, own=own, printed=stated.print_resolution
            )
        )
        blend = np.where(np.isfinite(parsed.blend), parsed.blend, law.distance)
        columns = load_checks(parsed.dialect).copy_printed_columns(parsed.configuration)
        try:
            texts = render_expected_text(
                Path(name).stem, program, post, controller, numbers_by_axis=columns, zone=replace(law, distance=blend)
            )
        except InputError as problem:
            return [*checks, build_failed_program_check(name, "wording", str(problem.reason))]
        folder = Path(name).parents[find_language(parsed.dialect).parent_levels]
        wanted = {(folder / f).as_posix(): text for f, text in texts.items()}
        if set(wanted) != set(files):
            odd = sorted(set(wanted) ^ set(files))
            return [
                *checks,
                build_failed_program_check(
                    name, "wording", f"{odd[0]} is " + ("missing" if odd[0] in wanted else "not of it")
                ),
            ]
        wrong = [w for file, text in wanted.items() if (w := self._find_wrong_text(file, text, keys))]
        where = "; ".join(wrong[:2]) or "every line as the post writes it"
        return [*checks, build_file_check(name, "wording", not wrong, float(len(wrong)), 0.0, "files", where)]

    def _find_wrong_text(self, file: str, text: str, keys: PostKeys) -> str:
        """Return the first difference between a file and its expected text, empty where there is none."""
        data = (self.out / file).read_bytes()
        strange = find_undecodable_bytes(data, keys.encoding)
        if strange is not None:
            return f"{file}, line {strange[0]}: {strange[1]} where the post writes {keys.encoding} only"
        found = data.decode(keys.encoding)
        off, ends = find_text_difference(found, [text]), find_wrong_line_end(found, keys.line_end)
        if off is not None:
            return f"{file}, line {off.line}: {off.found[:70]!r} where the post writes {off.expected[:70]!r}"
        if ends is not None:
            return f"{file}, line {ends}: does not end in {keys.line_end.upper()} as the post ends its lines"
        return ""

    def _build_program(
        self, parsed: ParsedProgram, program: ProgramInCell, controller: RobotController, q: Array, external: Array
    ) -> RobotProgram:
        """The program as the post took it, from what was read; joints are the motion's, which only zones look at."""
        cell, n = self.cell, len(program)
        standing = compute_controller_posture(load_robot(cell), q, controller)
        labels = list(dict.fromkeys(o for o in program.operation if o))
        number = {"": -1, **{label: n for n, label in enumerate(labels)}}
        own = self.toolpath.events
        events = (
            tuple(replace(e, index=r.index) for e, r in zip(own, parsed.events, strict=True))
            if (len(own) == len(parsed.events))
            else parsed.events
        )
        linear = program.kind == LIN
        feed = np.where(linear, np.where(program.feed > 0.0, program.feed, 1.0), np.nan)
        kind = program.kind.copy()
        kind[0] = 0  # a program begins with a joint move; that this one does is seen in its text
        feed[0] = np.nan
        return RobotProgram(
            kind=kind,
            q=q,
            T_workpiece_tcp=program.T_workpiece_tcp,
            feed=feed,
            cutting=(kind == LIN) & (program.move == MoveKind.CUT),
            move=program.move,
            operation=np.array([number[o] for o in program.operation], np.int32),
            operations=tuple(labels),
            T_flange_tcp=cell.tool.T_flange_tcp,
            T_base_workpiece=compute_workpiece_in_base(cell, cell.external_home),
            external=external,
            external_axes=list_external_axes(cell),
            T_carrier_workpiece=get_workpiece_on_positioner(cell),
            ptp_speed=self.options.rapid_scale,
            events=events,
            blend=0.0 if program.is_streamed else self.tolerance.position,
            rapid_share=None if self.rapid is None else self.rapid[0],
            rapid_zone=None if self.rapid is None else self.rapid[1],
            source=self.source,
            joint_names=cell.arm_joints,
            time=np.arange(n, dtype=float) if program.is_streamed else None,
            wrist_behind=None if standing is None else standing[0],
            elbow_up=None if standing is None else standing[1],
            axis_velocity=cell.limits.velocity[:6],
            axis_acceleration=cell.limits.acceleration[:6],
            tool_com=cell.tool.com,
            tool_mass=cell.tool.mass if cell.tool.mass > 0.0 else float("nan"),
        )


def build_failed_program_check(file: str, what: str, text: str) -> VerificationCheck:
    """Return a failed check of a program, without a number.

    Args:
        file: Name of the program file.
        what: Name of the checked quantity.
        text: What is wrong.
    """
    return build_file_check(file, what, False, float("nan"), 0.0, "", text)
