"""What a plan needs compiled, with the types it is called with: ``python -m machopt.plan.kernels`` stores it all.

They are compiled while a wheel is built (``.hatch/kernels.py``); what an installation did not bring is compiled when it
is first called. On such a first run a second process begins with the kernel that is needed last
(:func:`compile_beside`), so that two cores share the work: numba itself compiles one function at a time. On every later
run a thread takes what is stored (:func:`taken_beside`) while the job is read.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Thread
from typing import Any

_F1, _F2, _F3, _I1, _S1 = "f8[::1]", "f8[:,::1]", "f8[:,:,::1]", "i8[::1]", "i4[::1]"
_FIXED = "Array(float64, 1, 'C', readonly=True)"
_P = f"{_F2},{_I1},{_F1},{_F1},{_F2},{_F2}"  # convex parts of a body
_C = f"{_F3},{_F1},f8,{_I1},{_I1},{_I1}"  # triangles by the cells of a grid
# triangles of bodies, and of what they are held against
_MESHES = f"{_F3},{_F2},{_F2},{_F2},{_I1},{_I1},{_I1},{_I1},{_F3},{_F2},{_I1},{_I1},{_I1},{_I1}"
# stations × values × rotations × branches
_LATTICE = f"{_F2},{_F3},i1[:,:,::1],{_F3},{_F2},i8[:,::1],i8,b1,b1[:,::1],{_F2},{_F1}"
KERNELS = (  # in the order in which a plan needs them: module, function, types of its arguments
    ("model.chain", "poses", f"{_F2},{_F2},{_F2},{_F2},{_F3}"),
    ("model.boxes", "_divide", f"{_F3},{_F2},{_F2},{_I1},{_I1},{_I1},{_I1},{_F1}"),
    ("plan.stations.transport", "_carry", f"{_F2},{_F2}"),
    ("model.ik_spherical", "_solve_all", f"UniTuple(UniTuple(f8,3),15),UniTuple(f8,10),{_F3},{_F3},{_F3},{_F1}"),
    ("model.ik", "_judge", f"{_F3},{_F3},{_F1},{_F2},{_F1},{_F1},u1[:,::1],b1[:,:,::1]"),
    ("model.chain", "links", f"{_F2},{_F2},{_F2},f8[:,:,:,::1],{_F3}"),
    ("model.chain", "jacobians", f"{_F2},{_F2},{_F2},{_F2},{_F3},{_F3}"),
    ("plan.choice.baseline", "_nearest_to_last", f"{_F3},u1[:,::1],b1[::1],{_F2},{_F1},{_F1},{_FIXED}"),
    (
        "plan.choice.sequence",
        "cheapest_sequence",
        f"{_F3},f8[:,:,:,::1],{_F2},b1[:,:,:,::1],{_S1},b1,{_S1},{_F1},{_F1},{_F1},{_F1},{_F1},{_F1},f8,{_I1},{_S1},{_S1},{_I1},i4[:,::1],b1[::1],b1[:,:,::1],b1[:,::1],b1,{_I1},{_F1},i2[::1]",
    ),
    (
        "model.triangles",
        "follow",
        f"{_MESHES},{_I1},{_F3},{_F1},f8[:],{_F1}",
    ),
    (
        "model.triangles",
        "_at",
        f"{_MESHES},{_F2},i8,i8",
    ),
    (
        "model.touching",
        "_rows",
        f"{_F2},{_F2},{_F3},{_F2},{_F2},{_F2},{_I1},{_I1},{_I1},{_I1},{_F3},{_F2},{_F2},{_F2},{_I1},{_I1},{_I1},{_I1},{_F3},f8",
    ),
    ("plan.feed.blend", "_carry", f"{_F2},{_F1}"),
    ("plan.feed.blend", "_grade", f"{_F1},{_F1}"),
    ("plan.feed.blend", "_round", f"{_F1},{_I1},{_F1},{_F1},{_F2},{_F3}"),
    ("plan.feed.blend", "_shrink", f"{_F1},{_F1},{_F1},{_F1},{_F1}"),
    ("plan.feed.blend", "_finest", f"{_F1},{_F1},{_F1},f8,{_F1}"),
    ("plan.feed.blend", "_spread", f"{_F1},{_F1}"),
    ("plan.feed.taylor", "_frames", f"{_F3},{_F3},{_F2}"),
    ("plan.feed.taylor", "_twists", f"{_F3},f8[:,:,:,::1]"),
    ("plan.feed.follow", "_refine", f"{_F2},{_F2},{_F2},{_F3},{_F2}"),
    ("plan.feed.follow", "_chain", f"{_F2},{_F2},{_F2},{_F1},{_F3},{_F3},{_F2},{_F1}"),
    ("plan.motion.over_cuts", "_deepest", f"{_F3},{_F2},{_F2},f8,f8"),
    ("plan.feed.feedsteps", "corners", f"{_F1},{_F1},{_F1}"),
    ("plan.feed.feedsteps", "greedy", f"{_F1},{_F3},{_F1},{_F1},{_F2},{_F1},{_F1},f8,i8,b1"),
    ("verify.inorder", "targets_in_order", f"{_F2},{_F3},{_F2},{_F2},{_F3},{_F2},b1[::1],{_F2},f8,i8"),
    ("verify.inorder", "lines_in_order", f"{_F2},{_F2},{_F2},{_F2},b1[::1],f8,f8,f8,i8"),
    ("verify.arm", "_placed", f"{_F2},{_I1},{_F3},{_F2},{_F2},{_F2}"),
    ("verify.contact", "_seen", f"f8[:,:,:,::1],i8,i8,{_I1}"),
    ("verify.contact", "_chords", f"{_F3},{_F1},f8"),
    ("verify.bodies", "_gap", f"{_F3},b1,{_F2},{_F1},{_F1},{_F2},f8"),
    ("verify.between", "_follow", f"{_P},{_P},{_F3},{_I1},{_F1},{_F1}"),
)


MORE = (  # what only some plans need: other arms, arms as they are built, external joints, gouges
    ("model.ik_parallel", "_solve_all", f"UniTuple(UniTuple(f8,3),13),UniTuple(f8,9),{_F3},{_F3}"),
    ("model.ik_newton", "newton", f"{_F2},{_F2},{_F2},{_F3},{_I1},{_F2},i8"),
    ("model.ik_newton", "unique", f"{_F2},{_I1},{_F1},i8,i8,f8"),
    ("model.ik_newton", "track", f"{_F2},{_F2},{_F2},{_F3},{_I1},{_I1},{_F2}"),
    ("model.ik_built", "led", f"{_F2},{_F2},{_F2},{_F3},{_F3}"),
    ("model.ik_grid", "_label", "f8[:,:,:,::1],f8[:,:,:,::1],f8"),
    ("model.chain", "moved_links", f"{_F2},{_F2},b1[::1],{_F2},f8[:,:,:,::1],{_F3}"),
    (
        "plan.external.moving_sequence",
        "steps",
        f"{_F3},{_F3},i8[:,::1],i8,i8,b1[::1],b1[::1],b1[::1],{_F1},{_F1},{_F1},{_F1},{_F1},{_F1},f8,f8",
    ),
    (
        "plan.best.lattice",
        "reach",
        f"{_LATTICE},i8,{_F2},f8",
    ),
    ("plan.best.lattice", "follow", f"{_LATTICE},i8"),
    ("plan.external.moving_sequence", "walk", f"{_F2},f4[:,:,::1],i8[:,::1],{_F3},i8,i8,b1[::1],{_F1}"),
    ("plan.jointly.interior_point", "indices", f"{_F2},{_F1},{_F2},{_F3}"),
    ("plan.jointly.interior_point", "lengths", f"{_F2},{_I1},{_F2},{_F1}"),
    (
        "plan.jointly.interior_point",
        "derived",
        f"{_F2},f8,{_F2},{_F3},{_F1},{_F2},{_F3},b1[::1],f8,{_I1},{_F2},{_F1},{_F1},{_F1},{_F1},{_F1},{_F1},{_F1},f8",
    ),
    (
        "plan.jointly.interior_point",
        "moved",
        f"{_F2},f8,f8,f8,b1[::1],{_I1},{_F2},{_F1},{_F1},{_F2},{_F1},{_F1},{_F1},{_F1},{_F1},{_F1},{_F1}",
    ),
    (
        "model.depth",
        "_rows",
        f"{_F2},{_I1},{_F1},{_F3},{_F3},{_F2},{_F2},{_I1},{_I1},{_I1},{_I1},{_F2},f8",
    ),
    ("verify.gouge", "_candidates", f"{_F2},{_F3},{_F2},{_F1},{_F1},{_C},{_C},{_C},f8"),
    ("model.chain", "between", f"{_F2},{_F2},b1[::1],i8,i8,{_F2},{_F3}"),
    ("model.ik_bridge", "_three_parallel", f"UniTuple(UniTuple(f8,3),12),{_F3},{_F3}"),
    ("model.ik_newton", "polish", f"{_F2},{_F2},{_F2},{_F3},{_F3},i8,f8"),
    ("plan.contacts.lookahead", "_neighbours", f"{_I1},b1[::1],b1[:,::1],b1[::1],i8,i8"),
    # laws with a memory: of a diagnosis, and of a job whose stiffness.yaml has them
    ("effects.hysteresis", "_play", f"{_F1},{_I1},f8"),
    ("effects.hysteresis", "_drag", f"{_F1},{_I1},f8,f8"),
    ("effects.creep", "_lag", f"{_F1},{_F1},{_I1},f8"),
    ("effects.friction", "_presliding", f"{_F1},f8,{_I1},f8,i8"),
    ("effects.vibration", "_mass_on_spring", f"{_F1},{_F1},{_F1},{_I1},f8,f8"),
)


def compile_all(kernels: Iterable[tuple[str, str, str]] = KERNELS[::-1]) -> list[Any]:
    """Compile what is not stored yet, by default the last first; returns the compiled functions."""
    made = []
    for kernel, types in _meant(kernels):
        kernel.compile(types)
        made.append(kernel)
    return made


def _meant(kernels: Iterable[tuple[str, str, str]]) -> Iterator[tuple[Any, tuple[Any, ...]]]:
    """Each function with the types of its arguments as numba has them: code is stored by these, not by the words."""
    from importlib import import_module

    from numba.core.sigutils import normalize_signature

    for module, name, types in kernels:
        yield getattr(import_module(f"machopt.{module}"), name), normalize_signature(f"({types})")[0]


@contextmanager
def taken_beside(*also: str) -> Iterator[None]:
    """In a thread, take from the store what a plan will call, in that order; nothing is begun any more after the block.

    Half of that is LLVM's work, without the interpreter's lock. It ends at the first kernel that is not stored: this is
    a first run then, and compiling is for the plan. It ends at an entry that names nothing, too: a plan needs none of
    this, and a test holds that there is no such entry.

    Args:
        also: modules that are wanted after the plan, imported last, while compiled code does the planning.
    """
    from importlib import import_module

    from machopt.compiled import take
    from machopt.model.threads import cores

    if cores() < 2:  # the plan would wait for it, also for what it does not call
        yield
        return
    over = Event()

    def take_all() -> None:
        with suppress(ImportError, AttributeError):
            for kernel, types in _meant(KERNELS):
                if over.is_set() or not take(kernel, types):
                    return
            for module in also:
                import_module(module)

    beside = Thread(target=take_all, name="kernels")
    beside.start()
    try:
        yield
    finally:
        over.set()
        beside.join()


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


def compile_into(folder: Path) -> None:
    """Compile all that a plan may need, for an installation to bring; processes that share a folder share the work."""
    from importlib import import_module

    from machopt.compiled import store

    every = KERNELS + MORE
    for module, name, _ in every:
        store(getattr(import_module(f"machopt.{module}"), name), folder)
    for module in sorted({module for module, _, _ in every}, key=_longest_first):
        try:
            (folder / f"{module}.claimed").touch(exist_ok=False)
        except FileExistsError:
            continue
        compile_all(entry for entry in every if entry[0] == module)


LONGEST = (
    "plan.choice.sequence",
    "verify.between",
    "model.triangles",
    "plan.feed.feedsteps",
    "model.touching",
)  # half the work


def _longest_first(module: str) -> tuple[int, str]:
    return (LONGEST.index(module) if module in LONGEST else len(LONGEST), module)


if __name__ == "__main__":
    if sys.argv[1:]:
        compile_into(Path(sys.argv[1]))
    else:
        compile_all()
