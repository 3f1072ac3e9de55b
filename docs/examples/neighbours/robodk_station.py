"""A plan into a RoboDK station, and a program of the station back as a toolpath.

Runs where RoboDK's Python API is (inside RoboDK: Tools, Run script; or beside it: pip install robodk). It needs
nothing of machopt but what ``machopt optimize … --post json`` wrote:

    python robodk_station.py push out/part/part_cls.json           # frame, tool, joint targets and a program
    python robodk_station.py pull "Main program" part.csv          # its moves as a point table for machopt

Before anything is added, the robot of the station is held against the plan: its forward kinematics at the plan's
joints has to be the plan's flange, but for one frame that stays the same. Where the station's robot counts an axis the
other way or from another zero, ``--sign`` and ``--offset-deg`` say so.
"""

import argparse
import csv
import json
import math
import sys
from pathlib import Path

SAME_MM, SAME = 0.1, 1e-3  # a station's robot is the plan's within this: mm, and entries of a rotation
LOOKED_AT = 25  # moves compared
STEP_MOVE, MOVE_JOINT, MOVE_LINEAR = 0, 1, 2  # INS_TYPE_MOVE, MOVE_TYPE_JOINT, MOVE_TYPE_LINEAR
ROBOT, PROGRAM, COMMENT = 2, 8, 3  # ITEM_TYPE_ROBOT, ITEM_TYPE_PROGRAM, INSTRUCTION_COMMENT


def push(rdk, matrix, file, robot_name="", sign=(1,) * 6, offset_deg=(0,) * 6):
    """Add frame, tool, joint targets and a program to the open station.

    Args:
        rdk: robodk.robolink.Robolink().
        matrix: makes RoboDK's matrix of four rows (robodk.robomath.Mat).
        file: what ``--post json`` wrote.
        robot_name: of the station's robot; empty: its only one.
        sign, offset_deg: station = sign · plan + offset, one for each axis.

    Returns:
        The program's item.
    """
    told = json.loads(Path(file).read_text(encoding="utf-8"))
    if told.get("machopt_program") != 1:
        raise SystemExit(f"{file}: is no program of machopt optimize --post json")
    robot = rdk.Item(robot_name, ROBOT)
    if not robot.Valid():
        raise SystemExit(f"the station has no robot {robot_name!r}; open the station with your robot first")
    moves = [m for m in told["moves"] if m["item"] in ("ptp", "lin")]
    workpiece, tool = _pose(told["workpiece_in_robot"]), _pose(told["tool_in_flange"])

    def joints(move):
        own = [s * q + o for s, q, o in zip(sign, move["q_deg"], offset_deg, strict=True)]
        return [*own, *move.get("external", [])]

    mount = _mount(robot, joints, moves, workpiece, tool)
    frame = rdk.AddFrame(f"{told['name']} workpiece", robot.Parent())
    frame.setPose(matrix(workpiece))
    spindle = robot.AddTool(matrix(_product(mount, tool)), f"{told['name']} tool")
    program = rdk.AddProgram(told["name"], robot)
    program.setPoseFrame(frame)
    program.setPoseTool(spindle)
    speed = rounding = operation = None
    number = 0
    for entry in told["moves"]:
        if entry["item"] not in ("ptp", "lin"):  # what the CAM file says beside moves: a comment, never an action
            program.RunInstruction(f"CAM: {entry.get('text', entry['item'])}", COMMENT)
            continue
        number += 1
        if entry.get("operation") not in (None, operation):
            operation = entry["operation"]
            program.RunInstruction(f"operation: {operation}", COMMENT)
        if entry["item"] == "lin" and entry["feed_mm_min"] != speed:
            speed = entry["feed_mm_min"]
            program.setSpeed(speed / 60.0)  # mm/s
        if entry["blend_mm"] != rounding:
            rounding = entry["blend_mm"]
            program.setRounding(rounding if rounding > 0 else -1)  # -1: exact stop
        target = rdk.AddTarget(f"{told['name']} {number}", frame, robot)
        target.setAsJointTarget()
        target.setJoints(joints(entry))
        (program.MoveL if entry["item"] == "lin" else program.MoveJ)(target)
    program.ShowTargets(False)
    return program


def pull(rdk, program_name, file):
    """Write the moves of a station's program as a point table: joint moves are rapid, linear ones cut.

    Feeds and tools are not in what RoboDK tells of a move: ``machopt optimize … --feed`` says one.
    """
    program = rdk.Item(program_name, PROGRAM)
    if not program.Valid():
        raise SystemExit(f"the station has no program {program_name!r}")
    rows = []
    for k in range(program.InstructionCount()):
        name, kind, way, _, pose, _ = program.Instruction(k)
        if kind != STEP_MOVE:
            if kind == 1:  # INS_TYPE_MOVEC
                raise SystemExit(f"instruction {k} ({name}) is an arc; turn arcs into lines in RoboDK first")
            continue
        if way not in (MOVE_JOINT, MOVE_LINEAR):
            raise SystemExit(f"instruction {k} ({name}) is neither a joint nor a linear move")
        place = [pose[i, 3] for i in range(3)]
        axis = [-pose[i, 2] for i in range(3)]  # from the tip to the shank
        reference = [pose[i, 0] for i in range(3)]
        numbers = [f"{v:.6f}" for v in place] + [f"{v:.9f}" for v in (*axis, *reference)]
        rows.append([*numbers, "rapid" if way == MOVE_JOINT else "cut"])
    if not rows:
        raise SystemExit(f"program {program_name!r} holds no moves")
    with open(file, "w", newline="", encoding="utf-8") as out:
        writer = csv.writer(out)
        writer.writerow(["x_mm", "y_mm", "z_mm", "i", "j", "k", "rx", "ry", "rz", "move"])
        writer.writerows(rows)
    return len(rows)


def _mount(robot, joints, moves, workpiece, tool):
    """The plan's flange in the station's, which must be the same at every move.

    External axes move the base, and nothing can be compared then.
    """
    if any("external" in m for m in moves):
        print("external axes: the station's robot is NOT compared with the plan", file=sys.stderr)
        return [[float(i == j) for j in range(4)] for i in range(4)]
    found = []
    for move in moves[:: max(len(moves) // LOOKED_AT, 1)]:
        theirs = robot.SolveFK(joints(move))
        theirs = [[theirs[i, j] for j in range(4)] for i in range(4)]
        ours = _product(_product(workpiece, _pose(move["pose"])), _inverse(tool))
        found.append(_product(_inverse(theirs), ours))
    first = found[0]
    off_mm = max(abs(T[i][3] - first[i][3]) for T in found for i in range(3))
    off = max(abs(T[i][j] - first[i][j]) for T in found for i in range(3) for j in range(3))
    if off_mm > SAME_MM or off > SAME:
        raise SystemExit(
            f"the station's robot is not the plan's: at the plan's joints its flange is off by {off_mm:.3g} mm and "
            f"{math.degrees(off):.3g} deg; --sign and --offset-deg say how its axes count, or it is another robot"
        )
    return first


def _pose(told):
    """Four rows, mm, from place and quaternion."""
    w, x, y, z = told["quaternion_wxyz"]
    n = math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / n, x / n, y / n, z / n
    px, py, pz = told["xyz_mm"]
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), px],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), py],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), pz],
        [0.0, 0.0, 0.0, 1.0],
    ]


def _product(A, B):
    return [[sum(A[i][k] * B[k][j] for k in range(4)) for j in range(4)] for i in range(4)]


def _inverse(T):
    R = [[T[j][i] for j in range(3)] for i in range(3)]
    p = [-sum(R[i][k] * T[k][3] for k in range(3)) for i in range(3)]
    return [[*R[0], p[0]], [*R[1], p[1]], [*R[2], p[2]], [0.0, 0.0, 0.0, 1.0]]


def _six(text):
    values = tuple(float(v) for v in text.split(","))
    if len(values) != 6:
        raise argparse.ArgumentTypeError("six numbers would work")
    return values


def main(words):
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("push", help="a plan into the open station")
    one.add_argument("program", type=Path, help="what --post json wrote")
    one.add_argument("--robot", default="", help="name of the station's robot (its only one)")
    one.add_argument("--sign", type=_six, default=(1.0,) * 6, help="1 or -1 for each axis")
    one.add_argument("--offset-deg", type=_six, default=(0.0,) * 6, help="degrees added to each axis")
    other = commands.add_parser("pull", help="a program of the station as a point table")
    other.add_argument("program", help="its name in the station")
    other.add_argument("table", type=Path, help="CSV to write")
    asked = parser.parse_args(words)

    from robodk import robolink, robomath

    rdk = robolink.Robolink()
    if asked.command == "push":
        done = push(rdk, robomath.Mat, asked.program, asked.robot, asked.sign, asked.offset_deg)
        print(f"{done.Name()}: {done.InstructionCount()} instructions")
    else:
        print(f"{asked.table}: {pull(rdk, asked.program, asked.table)} points; put it in the frame of the program")


if __name__ == "__main__":
    main(sys.argv[1:])
