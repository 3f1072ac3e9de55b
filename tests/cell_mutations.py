"""Damaged cells, robots, meshes, stiffness files, recordings and options: refused, or valid in every number.

The faults are typical of editors, exporters and users: a number with an extreme value or another notation, a misspelt
word, a lost, duplicated or moved line, a truncated file; one in ten is a random byte.
"""

from __future__ import annotations

import random
import re
import struct
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from minimal_cell_files import write_minimal_cell
from program_mutations import limit_time

from machopt.cell.cell_reader import load_cell
from machopt.cell.stiffness.stiffness_file import load_stiffness
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.plan_options import PlanOptions
from machopt.errors import InputError
from machopt.measurement.recording import load_recording
from machopt.options.option_schema import OptionKeys
from machopt.options.plan_option_reader import format_user_options, load_options

HANG = 30.0  # s, limit of the processor time for one small file
WILD = (
    "nan",
    "inf",
    "-inf",
    ".nan",
    ".inf",
    "1e30",
    "-1e30",
    "1e400",
    "1e-30",
    "0",
    "-0",
    "-1",
    "1e9",
    "3.1416",
    "190,0",
    "1_000",
    "0x10",
    "1e",
    "--3",
    "",
    " ",
    "true",
    "null",
    "~",
    "[]",
    "{}",
    "[1, 2]",
    "x",
    "ä",
    "\u0663",
    "0.001",
    "1000",
    "99999999999999999999",
    "1.2.3",
    "<",
    "&",
    '"',
    "'",
    "\t",
    "*a",
    "&a 1",
    "!x 1",
    "|",
    "- 1",
    "# 1",
)
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.])")
_WORD = re.compile(r"[A-Za-z_][A-Za-z_0-9]{2,}")


def damage_text(text: str, rng: random.Random) -> str:
    """Insert one to three faults into a text file."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        lines = text.split("\n")
        at, other = rng.randrange(len(lines)), rng.randrange(len(lines))
        match rng.randrange(14):
            case 0 | 1 | 2:
                text = replace_random_match(text, _NUMBER, rng, lambda _: rng.choice(WILD))
            case 10 | 11 | 12:
                text = replace_random_match(text, _NUMBER, rng, lambda number: change_number(number, rng))
            case 13:
                tag = rng.choice(re.findall(r"</(\w+)>", text) or ["x"])  # rename a whole element
                text = re.sub(rf"(</?){tag}\b", rf"\g<1>{misspell_word(tag, rng)}", text, count=2)
            case 3 | 4:
                text = replace_random_match(text, _WORD, rng, lambda word: misspell_word(word, rng))
            case 5:
                del lines[at]
                text = "\n".join(lines)
            case 6:
                lines.insert(other, lines[at])
                text = "\n".join(lines)
            case 7:
                lines[at], lines[other] = lines[other], lines[at]
                text = "\n".join(lines)
            case 8:
                k = rng.randrange(len(text) + 1)
                text = text[:k] if rng.random() < 0.5 else text[:k] + rng.choice(WILD) + text[k:]
            case _:
                k = rng.randrange(len(text) + 1)
                text = text[:k] + chr(rng.choice((0, 9, 10, 34, 60, 62, 123, 255, 0x2028, 0xFEFF))) + text[k + 1 :]
    return text


def change_number(number: str, rng: random.Random) -> str:
    """Return another number: in other units, with another sign, or slightly different."""
    value = float(number) * rng.choice((1e3, 1e-3, 57.29577951308232, 0.017453292519943295, -1.0, 1.01, 2.0, 1e-6))
    return f"{value:.9g}"


def misspell_word(word: str, rng: random.Random) -> str:
    k = rng.randrange(len(word))
    return rng.choice(
        (
            word[:k] + word[k + 1 :],
            word[:k] + word[k] + word[k:],
            word.upper(),
            word + "s",
            word[:k] + "x" + word[k + 1 :],
            word[::-1],
        )
    )


def replace_random_match(text: str, pattern: re.Pattern[str], rng: random.Random, by: Callable[[str], str]) -> str:
    found = list(pattern.finditer(text))
    if not found:
        return text
    hit = rng.choice(found)
    return text[: hit.start()] + by(hit.group()) + text[hit.end() :]


def damaged_bytes(data: bytes, rng: random.Random) -> bytes:
    """Insert one to three faults into a mesh file: truncated, extended, extreme numbers, wrong counts, lost or
    duplicated blocks."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 3))):
        if not out:
            break
        at = rng.randrange(len(out))
        match rng.randrange(9):
            case 7 | 8 if (
                len(out) >= 84 and len(out) == 84 + 50 * struct.unpack_from("<I", out, 80)[0]
            ):  # lost triangles, with the count adjusted
                del out[84 : 84 + 50 * rng.randint(1, 8)]
                out[80:84] = struct.pack("<I", (len(out) - 84) // 50)
            case 0:
                del out[at:]
            case 1:
                out += bytes(rng.randrange(256) for _ in range(rng.randint(1, 60)))
            case 2:
                out[at] = rng.randrange(256)
            case 3:
                out[at : at + 4] = struct.pack("<f", rng.choice((float("nan"), float("inf"), 1e30, -1e-30, 0.0, 1e3)))
            case 4 if len(out) > 84:
                out[80:84] = struct.pack("<I", rng.choice((0, 1, 11, 13, 2**32 - 1, 10**6)))
            case 5:
                out[at:at] = out[at : at + 50]
            case _:
                text = out.decode("latin-1")
                by = (lambda _: rng.choice(WILD)) if rng.random() < 0.5 else (lambda number: change_number(number, rng))
                out = bytearray(replace_random_match(text, _NUMBER, rng, by).encode("latin-1", "replace"))
    return bytes(out)


# conditions for all accepted input ----------------------------------------------------------------------------------


def sane_cell(folder: Path, *, model: bool = True) -> None:
    """Load the cell and check that every number is finite and in its range, and that planner and verifier have all
    bodies."""
    cell = load_cell(folder)
    limits = cell.limits
    assert (limits.lower < limits.upper).all()
    n = len(cell.arm_joints)
    assert ((limits.lower[:n] <= cell.home) & (cell.home <= limits.upper[:n])).all()
    for row in (limits.velocity, limits.acceleration, limits.jerk):
        assert ((row > 0.0) & np.isfinite(row)).all()
    for T in (cell.T_world_base, cell.tool.T_flange_tcp, cell.workpiece.T_link_workpiece):
        assert np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
        assert np.abs(T[:3, 3]).max() <= 1e3
    if model:
        from machopt.kinematics.urdf_loading import load_chain, load_masses
        from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

        robot, shapes = load_chain(cell)
        assert np.allclose(np.linalg.norm(robot.axis, axis=1), 1.0)
        assert len(shapes) == len(re.findall(r"<collision[\s>/]", re.sub(r"(?s)<!--.*?-->", "", cell.urdf.read_text())))
        masses = load_masses(cell)
        assert (masses.mass > 0.0).all()
        assert np.isfinite(masses.com).all()
        flange = UrdfKinematics(cell).compute_placements(cell.home[None], np.zeros((1, len(cell.external_joints))))[
            0, -2
        ]
        assert np.allclose(flange, cell.T_world_base @ robot.compute_fk(cell.home), atol=1e-9)


def sane_mesh(folder: Path) -> None:
    """Check that planner and verifier load the same body from the file."""
    import coal

    from machopt.collision.bodies import build_cell_bodies
    from machopt.kinematics.machine import load_machine
    from machopt.kinematics.machine_lines import LinkCarriers
    from machopt.kinematics.urdf_loading import load_chain

    cell = load_cell(folder)
    shape = cell.tool.geometry[0]
    robot, _ = load_chain(cell)
    ours = build_cell_bodies(cell, LinkCarriers(cell, load_machine(cell, robot)))[0]
    theirs = coal.MeshLoader().load(str(shape.mesh), np.full(3, shape.size[0]))
    theirs.computeLocalAABB()
    T = robot.T_base_flange_zero @ shape.T_parent_shape
    local = (ours.vertices - T[:3, 3]) @ T[:3, :3]
    local = local[np.unique(ours.faces)]
    size = float(np.ptp(local, axis=0).max())
    assert np.allclose(local.min(0), theirs.aabb_local.min_, atol=1e-5 * size)
    assert np.allclose(local.max(0), theirs.aabb_local.max_, atol=1e-5 * size)


def sane_stiffness(file: Path) -> None:
    found = load_stiffness(file)
    assert ((found.joints >= 1e2) & (found.joints <= 1e10)).all()
    if found.covariance is not None:
        assert np.allclose(found.covariance, found.covariance.T)
    if found.grid is not None:
        assert found.grid.joints.shape == (int(np.prod(found.grid.shape)), 6)
        assert (found.grid.joints > 0.0).all()


def sane_recording(recording: Recording) -> None:
    assert len(recording) > 0
    for name, value in vars(recording).items():
        if isinstance(value, np.ndarray) and value.dtype.kind == "f":
            assert len(value) == len(recording) or name in ("wrench_point",), name
            assert np.isfinite(value).all(), name


def sane_options(options: PlanOptions) -> None:
    """Check that the options equal those read back from their displayed form."""
    assert 0.0 < options.rotation_step <= np.pi
    assert load_options(format_user_options(options)) == options


# formats ----------------------------------------------------------------------------------------------------------

STIFFNESS = """\
machopt_stiffness: 1
joints_Nm_per_rad: [1.41e6, 4.01e5, 9.35e5, 3.60e5, 3.70e5, 380e3]
covariance:
  - [1e-15, 0, 0, 0, 0, 0]
  - [0, 1e-15, 0, 0, 0, 0]
  - [0, 0, 1e-15, 1e-17, 0, 0]
  - [0, 0, 1e-17, 1e-15, 0, 0]
  - [0, 0, 0, 0, 1e-15, 0]
  - [0, 0, 0, 0, 0, 1e-15]
grid:
  origin_mm: [1000, -500, 300]
  cell_mm: 500
  shape: [2, 1, 1]
  joints_Nm_per_rad:
    - [1.41e6, 4.01e5, 9.35e5, 3.60e5, 3.70e5, 380e3]
    - [1.31e6, 4.11e5, 9.25e5, 3.50e5, 3.60e5, 370e3]
terms:
  - {effect: link_compliance, location: "link:4", parameters: {c: 1e-7}}
"""
RECORDING = """\
machopt_recording: 1
kind: deflection
data: data.csv
wrench_frame: base
displacement_frame: base
registration: fixed
standard_uncertainty: {displacement_mm: 0.015, force_N: 5}
notes: made up
"""


def _readings() -> str:
    rng = np.random.default_rng(3)
    lines = ["pose,cycle,session," + ",".join(f"q{k}_deg" for k in range(1, 7)) + ",fx_N,fy_N,fz_N,dx_mm,dy_mm,dz_mm"]
    for pose in range(6):
        q = rng.uniform(-80, 80, 6)
        for _ in range(3):
            values = [*q, *rng.uniform(-900, 900, 3), *rng.uniform(-1, 1, 3)]
            lines.append(f"{pose},{pose},0," + ",".join(f"{v:.6f}" for v in values))
    return "\n".join(lines) + "\n"


def _meshes() -> list[tuple[str, bytes]]:
    box = trimesh.creation.icosphere(subdivisions=1, radius=0.1)
    kinds = (("stl", {}), ("stl_ascii", {}), ("ply", {}), ("ply", {"encoding": "ascii"}), ("off", {}), ("obj", {}))
    out = []
    for kind, options in kinds:
        data = box.export(file_type=kind, **options)
        out.append((kind.split("_")[0], data.encode() if isinstance(data, str) else data))
    return out


class Case:
    """Damaged versions of one format."""

    def __init__(self, name: str, place: Path) -> None:
        self.name, self.folder = name, write_minimal_cell(place / name)
        self._meshes = _meshes() if name == "mesh" else []
        if name == "recording":
            self.sound = {"recording.yaml": RECORDING, "data.csv": _readings()}
        elif name == "stiffness":
            self.sound = {"stiffness.yaml": STIFFNESS}
        else:
            self.sound = {f: (self.folder / f).read_text() for f in ("cell.yaml", "robot.urdf")}

    def try_one(self, rng: random.Random) -> None:
        """Write one damaged version, read it, and check the result.

        Raises:
            InputError: the file was refused, which is permitted.
            Exception: any other exception is a defect; the damaged file is not deleted.
        """
        match self.name:
            case "cell":
                self._write("cell.yaml", rng)
                sane_cell(self.folder, model=rng.random() < 0.2)
            case "urdf":
                self._write("robot.urdf", rng)
                sane_cell(self.folder)
            case "mesh":
                kind, data = rng.choice(self._meshes)
                text = self.sound["cell.yaml"].replace("spindle.stl", f"spindle.{kind}")
                (self.folder / "cell.yaml").write_text(text)
                (self.folder / f"spindle.{kind}").write_bytes(damaged_bytes(data, rng))
                sane_mesh(self.folder)
            case "stiffness":
                self._write("stiffness.yaml", rng)
                sane_stiffness(self.folder / "stiffness.yaml")
            case "recording":
                for name, text in self.sound.items():
                    (self.folder / name).write_text(text)
                self._write(rng.choice(list(self.sound)), rng)
                sane_recording(load_recording(self.folder))
            case _:
                sane_options(self._options(rng))

    def _write(self, name: str, rng: random.Random) -> None:
        text = damage_text(self.sound[name], rng)
        (self.folder / name).write_text(text, encoding="utf-8", errors="surrogatepass", newline="")

    def _options(self, rng: random.Random) -> PlanOptions:
        words = []
        for _ in range(rng.randint(1, 3)):
            key = rng.choice(
                [*OptionKeys.model_fields, "force_N.normal", "weights.mean", "fixed.point", "machopt_plan"]
            )
            key = misspell_word(key, rng) if rng.random() < 0.2 else key
            value = rng.choice((*WILD, *OPTION_VALUES))
            if key in DEFAULTS and rng.random() < 0.6:
                value = str(DEFAULTS[key]).replace("'", "").lower()
                value = (
                    value
                    if rng.random() < 0.3
                    else replace_random_match(value, _NUMBER, rng, lambda n: change_number(n, rng))
                )
            words.append(
                rng.choice((f"{key}={value}", f"{key} = {value}", f"{key}:{value}", f"{key}.{key}={value}"))
                if rng.random() < 0.2
                else f"{key}={value}"
            )
        if rng.random() < 0.5:
            return load_options(overrides=words)
        plan = self.folder / "plan.yaml"
        text = "\n".join(word.replace("=", ": ", 1) for word in words)
        plan.write_text(damage_text(text, rng) if rng.random() < 0.5 else text, errors="surrogatepass")
        return load_options(plan_file=plan)


OPTION_VALUES = (
    "global",
    "jiao2022",
    "deflection",
    "auto",
    "5",
    "0.5",
    "90",
    "180",
    "-180",
    "[-90, 90]",
    "[90, -90]",
    "{normal: 200}",
    "{axial: 1e4, travel: -3}",
    "{mean: 0, worst: 0}",
    "[{point: 3, gamma_deg: 45}]",
    "12",
    "false",
)
DEFAULTS = format_user_options(PlanOptions())
FORMATS = ("urdf", "mesh", "cell", "stiffness", "recording", "options")


def run(case: Case, count: int, rng: random.Random) -> Counter[str]:
    """Try ``count`` damaged versions and return how many were read and how many were refused.

    Raises:
        Exception: any exception other than a refusal.
    """
    out: Counter[str] = Counter()
    for _ in range(count):
        with limit_time(HANG):
            try:
                case.try_one(rng)
                out["read"] += 1
            except InputError as error:
                if not error.reason.strip():
                    raise
                out["refused"] += 1
    return out
