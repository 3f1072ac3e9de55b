"""What a plan needs compiled, with the types it is called with: ``python -m machopt.plan.kernels`` stores it all.

Kernels compile when they are first called. On the first run after installing, a second process begins with the one that
is needed last (:func:`compile_beside`), so that two cores share the work: numba itself compiles one function at a time.
"""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

_F1, _F2, _F3, _I1, _S1 = "f8[::1]", "f8[:,::1]", "f8[:,:,::1]", "i8[::1]", "i4[::1]"
_FIXED = "Array(float64, 1, 'C', readonly=True)"
_P = f"{_F2},{_I1},{_F1},{_F1},{_F2},{_F2}"  # convex parts of a body
KERNELS = (  # in the order in which a plan needs them: module, function, types of its arguments
    ("plan.carry", "_carry", f"{_F2},{_F2}"),
    ("model.ik_spherical", "_solve_all", f"UniTuple(UniTuple(f8,3),15),UniTuple(f8,10),{_F3},{_F3},{_F3},{_F1}"),
    ("model.ik", "_judge", f"{_F3},{_F3},{_F1},{_F2},{_F1},{_F1},u1[:,::1],b1[:,:,::1]"),
    ("plan.baseline", "_nearest_to_last", f"{_F3},u1[:,::1],b1[::1],{_F2},{_F1},{_F1},{_FIXED}"),
    (
        "plan.sequence",
        "cheapest_sequence",
        f"{_F3},f8[:,:,:,::1],{_F2},b1[:,:,:,::1],{_S1},b1,{_S1},{_F1},{_F1},{_F1},{_F1},{_F1},{_F1},f8,{_I1},{_S1},{_S1},b1",
    ),
    (
        "model.triangles",
        "follow",
        f"{_F3},{_F2},{_F2},{_F2},{_I1},{_I1},{_I1},{_I1},{_F3},{_F2},{_I1},{_I1},{_I1},{_I1},{_I1},{_F3},{_F1},f8[:],{_F1}",
    ),
    (
        "model.triangles",
        "_at",
        f"{_F3},{_F2},{_F2},{_F2},{_I1},{_I1},{_I1},{_I1},{_F3},{_F2},{_I1},{_I1},{_I1},{_I1},{_F2},i8,i8",
    ),
    ("model.touching", "_between", f"{_F2},{_F2},{_F3},f8"),
    (
        "model.touching",
        "_rows",
        f"{_F3},{_F2},{_F2},{_F2},{_I1},{_I1},{_I1},{_I1},{_F3},{_F2},{_F2},{_F2},{_I1},{_I1},{_I1},{_I1},{_F3},f8",
    ),
    ("plan.blend", "_carry", f"{_F2},{_F1}"),
    ("plan.blend", "_grade", f"{_F1},{_F1}"),
    ("plan.blend", "_round", f"{_F1},{_I1},{_F1},{_F1},{_F2},{_F3}"),
    ("plan.blend", "_shrink", f"{_F1},{_F1},{_F1},{_F1},{_F1}"),
    ("plan.blend", "_finest", f"{_F1},{_F1},{_F1},f8,{_F1}"),
    ("plan.blend", "_spread", f"{_F1},{_F1}"),
    ("plan.taylor", "_frames", f"{_F3},{_F3},{_F2}"),
    ("plan.taylor", "_twists", f"{_F3},f8[:,:,:,::1]"),
    ("plan.follow", "_refine", f"{_F2},{_F2},{_F2},{_F3},{_F2}"),
    ("plan.follow", "_chain", f"{_F2},{_F2},{_F2},{_F1},{_F3},{_F3},{_F2}"),
    ("plan.feedrate", "_corners", f"{_F1},{_F1},{_F1}"),
    ("plan.feedrate", "_law", f"{_F1},{_F3},{_F1},{_F1},{_F2},{_F1},{_F1},f8,i8,b1"),
    ("verify.arm", "_placed", f"{_F2},{_I1},{_F3},{_F2},{_F2},{_F2}"),
    ("verify.contact", "_seen", f"f8[:,:,:,::1],i8,i8,{_I1}"),
    ("verify.contact", "_chords", f"{_F3},{_F1},f8"),
    ("verify.bodies", "_gap", f"{_F3},b1,{_F2},{_F1},{_F1},{_F2},f8"),
    ("verify.between", "_follow", f"{_P},{_P},{_F3},{_I1},{_F1},{_F1}"),
)


def compile_all() -> list[Any]:
    """Compile what is not stored yet, the last first; returns the compiled functions."""
    from importlib import import_module

    kernels: list[Any] = [getattr(import_module(f"machopt.{module}"), name) for module, name, _ in KERNELS]
    for kernel, (_, _, types) in zip(reversed(kernels), reversed(KERNELS), strict=True):
        kernel.compile(f"({types})")
    return kernels


def compile_beside() -> subprocess.Popen[bytes] | None:
    """A second process that compiles, where there is a second core; whoever starts it ends it."""
    if (os.cpu_count() or 1) < 2:
        return None
    try:
        return subprocess.Popen(
            [sys.executable, "-m", "machopt.plan.kernels"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError:  # no process to be had: everything is compiled here
        return None


if __name__ == "__main__":
    compile_all()
