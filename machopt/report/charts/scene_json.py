"""3-D scene as JSON for ``assets/stage.js`` and ``assets/view.js``, with packed numbers."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.process_columns import OUTCOMES
from machopt.numerics.array_types import Array
from machopt.report.charts.point_reduction import round_for_json
from machopt.report.page_types.display_units import ANGLE, LENGTH
from machopt.report.scene.mesh_decimation import decimate_mesh
from machopt.report.scene.scene_types import (
    CellScene,
    MotionScene,
    SceneBody,
    ScenePostures,
    StationPostures,
    ToolpathScene,
)

Spec = dict[str, Any]  # JSON

MAX_TRIANGLES = 24_000  # of all bodies together: about 0.3 MB on the page
MIN_BODY_TRIANGLES = 200  # that any body may have
MAX_SAMPLES = 6_000  # of the motion
MISSING_LEVEL = 65535  # level of NaN


def reduce_bodies(bodies: tuple[SceneBody, ...], triangles: int = MAX_TRIANGLES) -> tuple[SceneBody, ...]:
    """Return the bodies with at most so many triangles; each gives up a share of what it has above FEWEST.

    Args:
        bodies: The bodies with their meshes.
        triangles: Maximum number of triangles of all bodies.
    """
    have = np.array([len(b.faces) for b in bodies], float)
    if have.sum() <= triangles:
        return bodies
    room = max(triangles - float(np.minimum(have, MIN_BODY_TRIANGLES).sum()), 0.0)
    extra = np.maximum(have - MIN_BODY_TRIANGLES, 0.0) ** 0.5  # the root: small bodies keep their shape next to scans
    allowed = np.minimum(have, MIN_BODY_TRIANGLES) + room * extra / extra.sum()
    out = []
    for body, most in zip(bodies, allowed.tolist(), strict=True):
        vertices, faces = decimate_mesh(body.vertices, body.faces, int(most))
        out.append(
            SceneBody(
                name=body.name, kind=body.kind, joint=body.joint, vertices=vertices, faces=faces, tools=body.tools
            )
        )
    return tuple(out)


def build_scene_spec(scene: CellScene) -> Spec:
    """Return the cell as JSON: lengths in m, angles in rad, matrices row by row.

    Args:
        scene: The cell's bodies for the 3-D view.
    """
    return {
        "root": round_for_json(scene.T_world_root.ravel(), 9),
        "joints": [
            {
                "name": j.name,
                "parent": j.parent,
                "axis": round_for_json(j.axis, 12),
                "point": round_for_json(j.point, 12),
                "prismatic": j.prismatic,
                "lower": _replace_non_finite(j.lower),
                "upper": _replace_non_finite(j.upper),
                "factor": (LENGTH if j.prismatic else ANGLE).factor,
                "unit": "\u202fmm" if j.prismatic else "°",
            }
            for j in scene.joints
        ],
        "coupling": None if scene.coupling is None else [round_for_json(row, 9) for row in scene.coupling],
        "tool": round_for_json(scene.T_root_tool.ravel(), 12),
        "tools": [{"name": name, "at": round_for_json(T.ravel(), 12)} for name, T in scene.tools],
        "tool_joint": scene.tool_joint,
        "part": round_for_json(scene.T_root_part.ravel(), 12),
        "part_joint": scene.part_joint,
        "base_joint": scene.base_joint,
        "bodies": [_build_body_spec(b) for b in reduce_bodies(scene.bodies) if len(b.faces)],
        "triangles": int(sum(len(b.faces) for b in scene.bodies)),
    }


def build_path_spec(path: ToolpathScene) -> Spec:
    """Return the toolpath as JSON; the page chooses the colours.

    Args:
        path: The toolpath as the 3-D view shows it.
    """
    known = path.value[np.isfinite(path.value)]
    low, high = (float(v) for v in np.percentile(known, [2, 98])) if known.size else (0.0, 1.0)
    return {
        "at": pack_floats(path.position),
        "point": pack_floats(path.point),
        "cutting": base64.b64encode(np.packbits(path.cutting, bitorder="little").tobytes()).decode("ascii"),
        "value": pack_floats(path.value),
        "label": path.label,
        "known": bool(known.size),
        "from": low,
        "to": high,
        "large_is_good": path.large_is_good,
        **_build_outcome_spec(path),
    }


def _build_outcome_spec(path: ToolpathScene) -> Spec:
    if path.outcome is None or path.p_in is None:
        return {}
    return {
        "outcomes": OUTCOMES,
        "outcome": base64.b64encode(path.outcome.tobytes()).decode("ascii"),
        "p_in": pack_floats(path.p_in),
        "cause": list(path.cause),
    }


def build_stations_spec(stations: StationPostures, pick: NDArray[np.intp]) -> Spec:
    """Return the data of the drawn stations of the map as JSON.

    Args:
        stations: Postures, stiffness and clearance at all stations.
        pick: Numbers of the drawn stations.
    """
    nearest = [stations.nearest[i] for i in pick]
    names = list(dict.fromkeys(nearest))
    number = {name: i for i, name in enumerate(names)}
    return {
        "q": pack_joint_levels(stations.q[pick]),
        "chosen": pack_joint_levels(stations.chosen[pick]),
        "k": pack_floats(stations.k[pick]),
        "force": None if stations.force is None else pack_floats(stations.force[pick]),
        "bend": None if stations.bend is None else pack_floats(stations.bend[pick]),
        "compliance": pack_floats(stations.compliance[pick]),
        "clearance": round_for_json(stations.clearance[pick] * LENGTH.factor, 5),
        "singularity": round_for_json(stations.singularity[pick] * ANGLE.factor, 4),
        "nearest": [number[name] for name in nearest],
        "names": names,
        "tool": None if stations.tool is None else stations.tool[pick].tolist(),
        "terms": list(stations.terms),
    }


def build_motion_spec(motion: MotionScene) -> Spec:
    """Return a subset of the motion samples as JSON; the page interpolates linearly between them.

    Args:
        motion: The motion as the 3-D view shows it.
    """
    k = np.unique(np.r_[0 : len(motion.time) : -(-len(motion.time) // MAX_SAMPLES), len(motion.time) - 1])
    return {
        "time": pack_floats(motion.time[k]),
        "q": pack_joint_levels(motion.q[k]),
        "point": pack_floats(motion.point[k]),
        "s": pack_floats(motion.s[k] * LENGTH.factor),
        "phi": pack_floats(motion.phi[k] * ANGLE.factor),
        "gamma": pack_floats(motion.gamma[k] * ANGLE.factor),
        "tool": None if motion.tool is None else motion.tool[k].tolist(),
    }


def build_posture_view(
    title: str, scene: CellScene, postures: ScenePostures | None = None, path: ToolpathScene | None = None
) -> Spec:
    """Return a 3-D view without a motion, for ``assets/posture.js``.

    Args:
        title: Title of the view.
        scene: The cell's bodies for the 3-D view.
        postures: Arm postures to choose from.
        path: The toolpath; None without one.
    """
    return {
        "title": title,
        "scene": build_scene_spec(scene),
        "path": None if path is None else build_path_spec(path),
        "postures": None
        if postures is None
        else {
            "q": pack_joint_levels(postures.q),
            "label": postures.label,
            "names": list(postures.names),
            "words": [[list(pair) for pair in row] for row in postures.words] or [[] for _ in postures.names],
            "vectors": [
                {
                    "name": v.name,
                    "color": v.color,
                    "at": pack_floats(v.values),
                    "length": 1.0 / (v.longest or _get_longest(v.values) or 1.0),
                }
                for v in postures.vectors
            ],
            "needles": [
                {
                    "color": n.color,
                    "of": base64.b64encode(n.posture_index.astype("<i4").tobytes()).decode("ascii"),
                    "at": pack_floats(n.values),
                    "length": 1.0 / (n.longest or 1.0),
                }
                for n in postures.needles
            ],
        },
    }


def build_empty_scene() -> CellScene:
    """Return a scene with a frame only, for a toolpath without a cell."""
    one = np.eye(4)
    return CellScene(T_world_root=one, joints=(), bodies=(), T_root_tool=one, T_root_part=one, tool_joint=-1)


def _get_longest(at: Array) -> float:
    sizes = np.linalg.norm(at, axis=1)
    return float(np.nanmax(sizes)) if np.isfinite(sizes).any() else 0.0


def pack_joint_levels(values: Array) -> Spec:
    """Return joint positions as 16-bit levels between the least and the largest of each; NONE is NaN.

    Args:
        values: (…, J) joint positions, rad or m.
    """
    flat = np.asarray(values, float).reshape(-1, values.shape[-1])
    known = np.isfinite(flat)
    low = np.where(known, flat, np.inf).min(axis=0, initial=np.inf)
    high = np.where(known, flat, -np.inf).max(axis=0, initial=-np.inf)
    low, high = np.where(np.isfinite(low), low, 0.0), np.where(np.isfinite(high), high, 0.0)
    step = np.where(high > low, (high - low) / (MISSING_LEVEL - 1), 1.0)
    out = np.full(flat.shape, MISSING_LEVEL, "<u2")
    out[known] = np.round((flat - low) / step)[known]
    return {
        "low": low.tolist(),
        "step": step.tolist(),
        "data": base64.b64encode(out.tobytes()).decode("ascii"),
    }


def pack_floats(values: Array) -> str:
    """Return values as base64 of little-endian 32-bit numbers.

    Args:
        values: The values.
    """
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")


def _build_body_spec(body: SceneBody) -> Spec:
    low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
    step = np.where(high > low, (high - low) / (MISSING_LEVEL - 1), 1.0)
    at = np.round((body.vertices - low) / step).astype("<u2")
    faces = body.faces.astype("<u2" if len(body.vertices) <= MISSING_LEVEL else "<u4")
    return {
        "name": body.name,
        "kind": body.kind,
        "joint": body.joint,
        "tools": list(body.tools),
        "low": low.tolist(),
        "step": step.tolist(),
        "at": base64.b64encode(at.tobytes()).decode("ascii"),
        "faces": base64.b64encode(faces.tobytes()).decode("ascii"),
        "wide": len(body.vertices) > MISSING_LEVEL,
    }


def _replace_non_finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
