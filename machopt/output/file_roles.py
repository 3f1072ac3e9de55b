"""The role of each file that a command writes, as its manifest lists it."""

from __future__ import annotations

ROLES = {
    "points.csv": "points",
    "trajectory.csv": "trajectory",
    "compensation.csv": "compensation",
    "tilt.csv": "tilt",
    "rapid_corners.csv": "corners",
    "engagement.csv": "engagement",
    "front.csv": "front",
    "result.json": "result",
    "identification.json": "result",
    "coefficients.json": "result",
    "frequency_response.json": "result",
    "diagnosis.json": "result",
    "plan.json": "result",
    "map.json": "result",
    "place.json": "result",
    "batch.json": "result",
    "report.html": "report",
    "summary.html": "report",
    "map.svg": "report",
    "stiffness.yaml": "stiffness",
    "kinematics.yaml": "kinematics",
    "process.yaml": "process",
    "readings.csv": "table",
    "cuts.csv": "table",
    "frequency_responses.csv": "table",
    "residuals.csv": "table",
    "readings_corrected.csv": "table",
    "readings_corrected.yaml": "recording",
    "unseen_poses.csv": "table",
    "poses.csv": "table",
    "map.csv": "table",
    "places.csv": "table",
    "map_free.csv": "table",
    "summary.csv": "table",
    "compare.csv": "table",
    "timings.csv": "table",
}

TABLES = tuple(name for name in ROLES if name.endswith(".csv"))
ROLES |= {name.removesuffix("csv") + "parquet": ROLES[name] for name in TABLES}  # copies, with --tables parquet

BATCH_ROLES = {
    "job.json": "record",
    "timing.json": "timing",
    "log.txt": "log",
}  # in the folder of each result of a batch
