"""The joint path of ``machopt optimize … --post compas_fab``: names, times and positions, without machopt or COMPAS.

    python joint_path.py out/part/part_cls.json

Any planner that takes a URDF takes these too: rad of joints that turn, m of joints that slide, by the URDF's own names.
"""

import json
import sys
from pathlib import Path


def joint_path(file):
    """Names (n), times (N) in s and positions (N, n) in rad or m."""
    data = json.loads(Path(file).read_text(encoding="utf-8"))["data"]
    times = [p["time_from_start"]["secs"] + 1e-9 * p["time_from_start"]["nsecs"] for p in data["points"]]
    return data["joint_names"], times, [p["joint_values"] for p in data["points"]]


def main(words):
    names, times, positions = joint_path(words[0])
    print(f"{len(times)} points over {times[-1]:.3f} s of {', '.join(names)}")
    for name, *values in zip(names, *positions, strict=True):
        print(f"  {name}: {min(values):.4f} to {max(values):.4f}")


if __name__ == "__main__":
    main(sys.argv[1:])
