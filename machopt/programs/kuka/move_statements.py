"""KRL motion statements: PTP, LIN, CIRC, SPL and their relative forms."""

from __future__ import annotations

import math
import re

import numpy as np

from machopt.programs.kuka.expression_values import KrlMemory, KrlValueError, try_evaluate
from machopt.programs.kuka.move_targets import AXES, KrlTargets, build_pose, get_numeric_component, list_external_values
from machopt.programs.reading.move_attributes import MoveAttributes
from machopt.programs.reading.parsed_program import JOINT, LINEAR
from machopt.programs.reading.program_builder import ProgramBuilder
from machopt.programs.reading.rotation_conventions import compute_fixed_xyz_rotation

_HERE = re.compile(r"\$(?:AXIS|POS)_(?:ACT|INT|RET|FOR)(?:_ME?A?S)?\s*", re.IGNORECASE)  # the present robot position
_HOME = re.compile(r"(?:X?HOME[0-9]*|\$H_POS)\s*", re.IGNORECASE)


class KrlMoves:
    """Carries moves out, and remembers what the next one may leave out."""

    def __init__(self, out: ProgramBuilder, memory: KrlMemory) -> None:
        self.out, self.memory = out, memory
        self.targets = KrlTargets(memory)
        self.corner = math.nan  # m, $APO.CDIS; the controller holds it until the program sets it
        self.joint_corner = math.nan  # % of half a move, $APO.CPTP; the controller holds it until the program sets it

    def move(self, word: str, rest: str, line: int) -> None:
        """Carry out a motion.

        Args:
            word: PTP, SLIN, LIN_REL …, in capitals.
            rest: what follows it: targets, approximation words, WITH.

        Raises:
            KrlValueError: the target cannot be known, or the move is not followed.
        """
        name = re.split(r"\s+C_", rest.strip())[0]
        if _HERE.fullmatch(name):
            self.out.ignore(f"{word} {name} (to the current position of the robot)", line, understood=True)
            self.out.warn_once(
                "a move to the current position of the robot is not part of the path; it is left out", line
            )
            return
        if "PTP" in word and _HOME.fullmatch(name) and not self.memory.plain.get(name.strip().upper()):
            self.out.warn_once(f"{word} {name.strip()} without a data list that says where it is: left out", line)
            self._read_move_target(line)
        elif word.endswith("_REL"):
            self._run_relative_move(word, rest, line)
        else:
            self._run_absolute_move(word, rest, line)

    def _run_absolute_move(self, word: str, rest: str, line: int) -> None:
        targets, flags = self.targets.read(rest, 2 if "CIRC" in word else 1)
        kind = JOINT if "PTP" in word else LINEAR
        blend = 0.0
        if flags:
            blend = self.corner if "C_DIS" in flags else math.nan
        if word == "SPL":
            self.out.warn_once("SPL: the curve between the points is the controller's own; straight lines are taken")
        feed = self.out.feed if kind == LINEAR else math.nan
        if re.search(r"\$(?:BASE|TOOL|IPO_MODE)\s*=", rest, re.IGNORECASE):
            raise KrlValueError("WITH $BASE, $TOOL or $IPO_MODE changes frames for one move: not followed")
        with_speed = re.search(r"\$VEL\.CP\s*=\s*([-+.0-9Ee]+)", rest, re.IGNORECASE)
        if with_speed:
            value = try_evaluate(with_speed.group(1), self.memory)
            feed = value if isinstance(value, float) and kind == LINEAR else feed
        target = targets[-1]
        if any(a in target for a in AXES):
            part = {"cptp": self.joint_corner} if kind == JOINT and "C_PTP" in flags else {}
            external = list_external_values(target)
            given = MoveAttributes(feed=feed, blend=blend, external=external, configuration=part)
            self.out.joint(self.targets.joints(target), line, given, kind=kind)
            return
        via = self.targets.full(targets[0]) if len(targets) == 2 else None
        full = self.targets.full(target)
        bits: dict[str, float] = {
            w: int(get_numeric_component(target, w)) for w in ("S", "T") if isinstance(target.get(w), float)
        }
        if kind == JOINT and "C_PTP" in flags:
            bits["cptp"] = self.joint_corner
        T = build_pose(full)
        given = MoveAttributes(feed=feed, blend=blend, external=list_external_values(target), configuration=bits)
        if via is not None:
            angle = re.search(r"\bCA\s+([-+.0-9]+)", rest, re.IGNORECASE)
            sweep_deg = float(angle.group(1)) if angle else None
            self.out.circle(build_pose(via), T, line, given, sweep_deg=sweep_deg)
            return
        rows = compute_fixed_xyz_rotation(full["C"], full["B"], full["A"])
        x, y, z = (full[c] * 1e-3 for c in "XYZ")
        self.out.pose(kind, rows, (x, y, z), line, given)

    def _read_move_target(self, line: int) -> None:
        """A joint move to a place that is not known: nothing of the last target holds any more."""
        self.out.joint([math.nan] * 6, line)
        self.targets.mark_target_unknown()

    def _run_relative_move(self, word: str, rest: str, line: int) -> None:
        """LIN_REL, PTP_REL: what is added to the last target, along the base's axes or (#TOOL) the tool's."""
        if "CIRC" in word or word == "SPL_REL":
            raise KrlValueError(f"{word} is not read; LIN_REL, or absolute targets, would work")
        (delta,), flags = self.targets.read(re.sub(r"#(?:BASE|TOOL)\b", " ", rest, flags=re.IGNORECASE), 1)
        blend = 0.0 if not flags else self.corner if "C_DIS" in flags else math.nan
        kind = JOINT if "PTP" in word else LINEAR
        feed = self.out.feed if kind == LINEAR else math.nan
        if any(a in delta for a in AXES):
            if not self.targets.axes or self.out.last is not None or kind == LINEAR:
                self._read_move_target(line)  # axes of a pose: only the robot knows them
                return
            self.targets.axes |= {a: self.targets.axes[a] + get_numeric_component(delta, a) for a in AXES if a in delta}
            self.out.joint([self.targets.axes[a] for a in AXES], line, MoveAttributes(blend=blend))
            return
        if self.out.last is None:
            raise KrlValueError(f"{word} starts at the current position of the robot, which the program does not state")
        if any(get_numeric_component(delta, c) for c in ("A", "B", "C") if c in delta):
            raise KrlValueError(f"{word} that turns the tool is not read; absolute targets would work")
        step = np.array([get_numeric_component(delta, c) * 1e-3 if c in delta else 0.0 for c in ("X", "Y", "Z")])
        T = self.out.last.copy()
        T[:3, 3] += T[:3, :3] @ step if re.search(r"#TOOL\b", rest, re.IGNORECASE) else step
        self.out.add_pose_move(kind, T, line, MoveAttributes(feed=feed, blend=blend))
        self.targets.pose |= {c: float(v) * 1e3 for c, v in zip("XYZ", T[:3, 3].tolist(), strict=True)}
