"""Compiled functions of a plan with their argument types; ``python -m machopt.planning.kernel_precompilation`` stores
them all.

They are compiled while a wheel is built (``.hatch/kernels.py``). A function that the installation does not contain is
compiled at its first call. On such a first run a second process starts with the kernel that is needed last
(:func:`start_compile_process`), so that two cores share the work: numba compiles one function at a time. On
every later run a thread loads the stored functions (:func:`preload_kernels_in_thread`) while the job is read.
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
# triangles of bodies, and of the bodies they are compared with
_MESHES = f"{_F3},{_F2},{_F2},{_F2},{_I1},{_I1},{_I1},{_I1},{_F3},{_F2},{_I1},{_I1},{_I1},{_I1}"
_BOX = f"Tuple(({_F1},{_F2},{_F1}))"  # centre, axes and half edges
# stations × values × rotations × branches
_LATTICE = f"{_F2},{_F3},i1[:,:,::1],{_F3},{_F2},i8[:,::1],i8,b1,b1[:,::1],{_F2},{_F1}"
_FIELD = "Tuple((i4[:,:,::1],i2[:,::1],i4[::1],i8[::1]))"  # stock as signed distances
KERNELS = (  # in the order in which a plan needs them: module, function, types of its arguments
    ("kinematics.product_of_exponentials", "compute_poses", f"{_F2},{_F2},{_F2},{_F2},{_F3}"),
    ("collision.bounding_box_tree", "_fill_tree", f"{_F3},{_F2},{_F2},{_I1},{_I1},{_I1},{_I1},{_F1}"),
    ("planning.stations.reference_transport", "_carry", f"{_F2},{_F2}"),
    (
        "kinematics.inverse.spherical_wrist",
        "_solve_all",
        f"UniTuple(UniTuple(f8,3),15),UniTuple(f8,10),{_F3},{_F3},{_F3},{_F1}",
    ),
    ("kinematics.inverse.solver", "_check_branches", f"{_F3},{_F3},{_F1},{_F2},{_F1},{_F1},u1[:,::1],b1[:,:,::1]"),
    ("kinematics.product_of_exponentials", "compute_link_motions", f"{_F2},{_F2},{_F2},f8[:,:,:,::1],{_F3}"),
    ("kinematics.product_of_exponentials", "compute_jacobians", f"{_F2},{_F2},{_F2},{_F2},{_F3},{_F3}"),
    ("planning.baselines", "_find_nearest_to_last", f"{_F3},u1[:,::1],b1[::1],{_F2},{_F1},{_F1},{_FIXED}"),
    (
        "planning.cost.lost_feed_time",
        "_compute_excess",
        f"{_F2},{_F2},{_F2},{_F2},{_F2},{_F3},{_F2},{_I1},{_F2},{_F1}",
    ),
    ("planning.cost.rapid_time", "compute_rest_time", "f8,f8,f8"),
    ("planning.motion.corner_timing", "_find_rates", f"{_F2},{_F2},{_F1}"),
    ("planning.motion.corner_timing", "_curve", f"{_F1},{_F2}"),
    ("planning.motion.corner_timing", "_measure_line", f"{_F1},{_F2}"),
    ("planning.motion.corner_timing", "_find_peak", f"f8,f8,f8,{_F1}"),
    ("planning.motion.corner_timing", "_change", f"f8,{_F1}"),
    (
        "planning.sequence_search.search_kernels",
        "find_cheapest_sequence",
        f"{_F3},f8[:,:,:,::1],i8,{_F2},b1[:,:,:,::1],{_S1},b1,{_S1},{_F1},{_F1},{_F1},{_F1},{_F1},{_F1},f8,{_I1},{_S1},{_S1},{_I1},i4[:,::1],b1[::1],b1[:,:,::1],b1[:,::1],b1,{_I1},{_F1},i2[::1],{_F2},{_F2},{_F1}",
    ),
    (
        "collision.mesh_distance",
        "compute_distances_along_rows",
        f"{_MESHES},{_I1},{_F3},{_F1},f8[:],{_F1}",
    ),
    (
        "collision.mesh_distance",
        "_compute_placed_distance",
        f"{_MESHES},{_F2},b1,i8,i8",
    ),
    ("collision.fcl_distance", "_find_boxed_vertices", f"{_F3},{_F1},{_F1},{_BOX},{_BOX}"),
    ("collision.bodies", "_sum_solid_angles", f"{_F2},i8[:,::1],{_F2}"),
    (
        "collision.distance_bounds",
        "_bound_pair_distances",
        f"f8[:,:,:,::1],i8,{_I1},b1[::1],{_F3},{_F2},{_I1},{_F2},{_F1},{_F2}",
    ),
    ("collision.distance_bounds", "_find_farther", f"{_F2},{_F1},{_F2},{_F1},{_F1}"),
    (
        "collision.proximity_test",
        "_check_rows",
        f"{_F2},{_F2},{_F3},{_F2},{_F2},{_F2},{_I1},{_I1},{_I1},{_I1},{_F3},{_F2},{_F2},{_F2},{_I1},{_I1},{_I1},{_I1},{_F3},f8",
    ),
    ("planning.retiming.path_curve", "_carry", f"{_F2},{_F1}"),
    ("planning.retiming.path_curve", "_grade", f"{_F1},{_F1}"),
    ("planning.retiming.path_curve", "_round", f"{_F1},{_I1},{_F1},{_F1},{_F2},{_F3}"),
    ("planning.retiming.path_curve", "_shrink", f"{_F1},{_F1},{_F1},{_F1},{_F1}"),
    ("planning.retiming.path_curve", "_finest", f"{_F1},{_F1},{_F1},f8,{_F1}"),
    ("planning.retiming.path_curve", "_spread", f"{_F1},{_F1}"),
    ("planning.retiming.taylor_series", "_frames", f"{_F3},{_F3},{_F2}"),
    ("planning.retiming.taylor_series", "_twists", f"{_F3},f8[:,:,:,::1]"),
    ("planning.retiming.joint_derivatives", "_refine", f"{_F2},{_F2},{_F2},{_F3},{_F2}"),
    ("planning.retiming.joint_derivatives", "_chain", f"{_F2},{_F2},{_F2},{_F1},{_F3},{_F3},{_F2},{_F1}"),
    ("planning.motion.depth_below_cuts", "_find_deepest", f"{_F3},{_F2},{_F2},f8,f8"),
    ("planning.motion.depth_below_cuts", "_find_higher", f"{_F3},{_F2},{_F2},f8"),
    ("planning.retiming.time_law_kernels", "find_next_corners", f"{_F1},{_F1},{_F1}"),
    (
        "planning.retiming.time_law_kernels",
        "compute_greedy_time_law",
        f"{_F1},{_F3},{_F1},{_F1},{_F2},{_F1},{_F1},f8,i8,b1",
    ),
    (
        "verification.programs.ordered_matching",
        "match_targets_in_order",
        f"{_F2},{_F3},{_F2},{_F2},{_F3},{_F2},b1[::1],{_F2},f8,f8,i8,b1[::1]",
    ),
    ("verification.motion.path_geometry.nearest_chords", "find_nearest_chords", f"{_F3},{_F3},{_I1},f8,f8,f8"),
    ("verification.programs.ordered_matching", "match_lines_in_order", f"{_F2},{_F2},{_F2},{_F2},b1[::1],f8,f8,f8,i8"),
    ("verification.motion.kinematics.urdf_kinematics", "_compute_frames", f"{_F2},{_I1},{_F3},{_F2},{_F2},{_F2}"),
    ("verification.motion.collision.contact_search", "_compute_relative_poses", f"f8[:,:,:,::1],i8,i8,{_I1}"),
    ("verification.motion.collision.contact_search", "_compute_chords", f"{_F3},{_F1},f8"),
    ("verification.motion.collision.bodies", "_bound_sphere_box_distance", f"{_F3},b1,{_F2},{_F1},{_F1},{_F2},f8"),
    ("verification.motion.collision.distance_bounds", "_bound_rows", f"{_P},{_P},{_F3},{_I1},{_F1},{_F1}"),
)


MORE = (  # needed by some plans only: other arms, as-built geometry, external joints, gouges, stability, stock
    ("planning.tolerance.draws_in_tolerance", "count_good_draws", f"{_F1},{_F1},{_F2},{_F2},f8,UniTuple(f8,3)"),
    ("verification.motion.process.draws_in_tolerance", "count_within", f"{_F2},{_F1},f8,{_F1},{_F1},f8,f8"),
    ("numerics.normal_interval_probability", "_fill_shares", f"{_F2},{_F1},{_F1},{_F2},{_F1}"),
    ("process.stock.mesh_columns", "_fill_columns", f"{_F3},{_F1},{_F1},f4[:,::1],f4[:,::1],f4[:,::1]"),
    (
        "process.stock.path_removal",
        "_remove_path",
        f"f4[:,:,::1],UniTuple(f8,2),UniTuple(f8,2),{_F2},b1[::1],UniTuple(f8,3),f8,{_F2},{_F1}",
    ),
    ("process.stock.field_mesh", "fill_blocks", f"{_F3},{_FIELD}"),
    (
        "process.stock.field_path",
        "_remove_path",
        f"{_FIELD},Tuple(({_F1},f8)),{_F2},{_F2},b1[::1],UniTuple(f8,4),{_F2},{_F1}",
    ),
    ("process.stock.field_differences", "compare_volumes", f"{_FIELD},{_FIELD}"),
    ("process.stock.field_differences", "measure_depths", f"{_FIELD},Tuple(({_F1},f8)),{_F2},{_F2}"),
    ("kinematics.inverse.three_parallel_axes", "_solve_all", f"UniTuple(UniTuple(f8,3),13),UniTuple(f8,9),{_F3},{_F3}"),
    ("kinematics.inverse.newton_iteration", "solve_from_rough_starts", f"{_F2},{_F2},{_F2},{_F3},{_I1},{_F2},i8"),
    ("kinematics.inverse.newton_iteration", "remove_duplicate_solutions", f"{_F2},{_I1},{_F1},i8,i8,f8"),
    ("kinematics.inverse.newton_iteration", "track_solutions", f"{_F2},{_F2},{_F2},{_F3},{_I1},{_I1},{_F2}"),
    ("kinematics.inverse.as_built_solver", "refine_branches", f"{_F2},{_F2},{_F2},{_F3},{_F3}"),
    ("kinematics.inverse.grid_solver", "_label_branches", "f8[:,:,:,::1],f8[:,:,:,::1],f8"),
    ("kinematics.product_of_exponentials", "compute_chain_motions", f"{_F2},{_F2},b1[::1],{_F2},f8[:,:,:,::1],{_F3}"),
    (
        "process.stability.depth_limit_kernels",
        "find_depth_limits",
        f"{_F1},UniTuple(b1,3),f8,{_F2},{_F2},{_F3},{_F3},{_F1},{_F1},{_I1},i8",
    ),
    (
        "planning.external_axes.moving_axis_kernels",
        "compute_transition_costs",
        f"{_F3},{_F3},i8[:,::1],i8,i8,b1[::1],b1[::1],b1[::1],{_F1},{_F1},{_F1},{_F1},{_F1},f8,f8",
    ),
    (
        "planning.external_axis_optimization.value_grid_search_kernels",
        "compute_reach_costs",
        f"{_LATTICE},i8,{_F2},f8",
    ),
    ("planning.external_axis_optimization.value_grid_search_kernels", "trace_cheapest_sequence", f"{_LATTICE},i8"),
    (
        "planning.external_axes.moving_axis_kernels",
        "find_cheapest_value_sequence",
        f"{_F2},f4[:,:,::1],i8[:,::1],{_F3},i8,i8,b1[::1],{_F1}",
    ),
    ("planning.continuous_refinement.interior_point_kernels", "compute_indices", f"{_F2},{_F1},{_F2},{_F3}"),
    ("planning.continuous_refinement.interior_point_kernels", "compute_absolute_arguments", f"{_F2},{_I1},{_F2},{_F1}"),
    (
        "planning.continuous_refinement.interior_point_kernels",
        "compute_newton_terms",
        f"{_F2},f8,{_F2},{_F3},{_F1},{_F2},{_F3},b1[::1],f8,{_I1},{_F2},{_F1},{_F1},{_F1},{_F1},{_F1},{_F1},{_F1},f8",
    ),
    (
        "planning.continuous_refinement.interior_point_kernels",
        "take_newton_step",
        f"{_F2},f8,f8,f8,b1[::1],{_I1},{_F2},{_F1},{_F1},{_F2},{_F1},{_F1},{_F1},{_F1},{_F1},{_F1},{_F1}",
    ),
    (
        "collision.gouge_depth_kernels",
        "compute_row_depths",
        f"{_F2},{_I1},{_F1},{_F3},{_F3},{_F2},{_F2},{_I1},{_I1},{_I1},{_I1},{_F2},f8",
    ),
    ("verification.motion.collision.gouge_check", "_bound_depths", f"{_F2},{_F3},{_F2},{_F1},{_F1},{_C},{_C},{_C},f8"),
    ("kinematics.product_of_exponentials", "compute_relative_motion", f"{_F2},{_F2},b1[::1],i8,i8,{_F2},{_F3}"),
    (
        "kinematics.inverse.general_solver_adapter",
        "_compute_three_parallel_margins",
        f"UniTuple(UniTuple(f8,3),12),{_F3},{_F3}",
    ),
    ("kinematics.inverse.newton_iteration", "polish_branches", f"{_F2},{_F2},{_F2},{_F3},{_F3},i8,f8"),
    ("planning.collision_handling.contact_lookahead", "_find_neighbours", f"{_I1},b1[::1],b1[:,::1],b1[::1],i8,i8"),
    (
        "planning.tilt.tilt_and_rotation_search_kernel",
        "find_joint_sequence",
        f"{_I1},i8[:,::1],{_F1},{_F2},i8[:,::1],b1[::1],{_F2},{_F1},{_F1}",
    ),
    ("planning.tilt.step_limit", "_shorten", f"{_F2},b1[::1],f8,i8"),
    # laws with memory: of a diagnosis, and of a job whose stiffness.yaml contains them
    ("effects.joint.play_and_drag_operators", "_integrate_play", f"{_F1},{_I1},f8"),
    ("effects.joint.play_and_drag_operators", "_integrate_drag", f"{_F1},{_I1},f8,f8"),
    ("effects.joint.creep", "_filter_first_order", f"{_F1},{_F1},{_I1},f8"),
    ("effects.joint.presliding_direction", "_integrate_presliding", f"{_F1},f8,{_I1},f8,i8"),
    ("effects.joint.joint_vibration", "_integrate_mass_on_spring", f"{_F1},{_F1},{_F1},{_I1},f8,f8"),
    # robust fits of identify and diagnose
    ("measurement.estimation.robust_weights", "_minimise_absolute_deviations", f"{_F2},{_F1}"),
    ("measurement.estimation.robust_weights", "sum_absolute_deviations", f"{_F2},{_F1},{_F1},f8"),
)


def compile_all(kernels: Iterable[tuple[str, str, str]] = KERNELS[::-1]) -> list[Any]:
    """Compile the kernels that are not stored yet, by default in reverse order.

    Args:
        kernels: module below ``machopt``, function name and argument types of each kernel.

    Returns:
        The compiled functions.
    """
    compiled = []
    for kernel, types in _iterate_kernels(kernels):
        kernel.compile(types)
        compiled.append(kernel)
    return compiled


def _iterate_kernels(kernels: Iterable[tuple[str, str, str]]) -> Iterator[tuple[Any, tuple[Any, ...]]]:
    """Yield each function with numba's normalised argument types, which are the keys of the stored code."""
    from importlib import import_module

    from numba.core.sigutils import normalize_signature

    for module, name, types in kernels:
        yield getattr(import_module(f"machopt.{module}"), name), normalize_signature(f"({types})")[0]


@contextmanager
def preload_kernels_in_thread(*also: str) -> Iterator[None]:
    """Load the stored kernels of a plan in a thread, in the order of use; none is started after the block.

    Half of that is LLVM's work without the interpreter lock. The thread stops at the first kernel that is not stored:
    this
    is a first run, and the plan compiles its kernels. It also stops at an entry that does not exist. A plan does not
    depend on the thread, and a test checks that every entry exists.

    Args:
        also: modules that are needed after the plan, imported last, while compiled code runs.
    """
    from importlib import import_module

    from machopt.numerics.compiled_functions import load_stored_kernel
    from machopt.numerics.parallel_map import count_threads

    if count_threads() < 2:  # the plan would wait for the thread, even for kernels it does not call
        yield
        return
    stopped = Event()

    def take_all() -> None:
        with suppress(ImportError, AttributeError):
            for kernel, types in _iterate_kernels(KERNELS):
                if stopped.is_set() or not load_stored_kernel(kernel, types):
                    return
            for module in also:
                import_module(module)

    thread = Thread(target=take_all, name="kernels")
    thread.start()
    try:
        yield
    finally:
        stopped.set()
        thread.join()


def start_compile_process() -> subprocess.Popen[bytes] | None:
    """Start a second process that compiles, where there is a second core; the caller terminates it."""
    if (os.cpu_count() or 1) < 2:
        return None
    try:
        return subprocess.Popen(
            [sys.executable, "-m", "machopt.planning.kernel_precompilation"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError:  # no process available: everything is compiled here
        return None


def compile_into(folder: Path) -> None:
    """Compile all kernels a plan may need into a folder of the installation; processes that share it divide the work.

    Args:
        folder: receives the compiled code, and one ``.claimed`` file per module that a process has taken.
    """
    from importlib import import_module

    from machopt.numerics.compiled_functions import enable_kernel_storage

    every = KERNELS + MORE
    for module, name, _ in every:
        enable_kernel_storage(getattr(import_module(f"machopt.{module}"), name), folder)
    for module in sorted({module for module, _, _ in every}, key=_rank_by_length):
        try:
            (folder / f"{module}.claimed").touch(exist_ok=False)
        except FileExistsError:
            continue
        compile_all(entry for entry in every if entry[0] == module)


LONGEST = (
    "planning.sequence_search.search_kernels",
    "verification.motion.collision.distance_bounds",
    "collision.mesh_distance",
    "planning.retiming.time_law_kernels",
    "collision.proximity_test",
)  # half the work


def _rank_by_length(module: str) -> tuple[int, str]:
    return (LONGEST.index(module) if module in LONGEST else len(LONGEST), module)


if __name__ == "__main__":
    if sys.argv[1:]:
        compile_into(Path(sys.argv[1]))
    else:
        compile_all()
