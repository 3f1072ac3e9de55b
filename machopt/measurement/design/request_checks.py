"""Checks of the request of a measurement plan."""

from __future__ import annotations

from math import isfinite

from machopt.errors import InputError, OptionError
from machopt.measurement.design.request import MOST_CYCLES, MOST_LOADS, MOST_POSES, MOST_STARTS, SENSORS, PosesRequest


def check_poses_request(request: PosesRequest) -> None:
    """Check a request.

    Args:
        request: Validated user request.

    Raises:
        InputError: Names the option, the value found and what would be accepted.
    """
    _check_counts(request)
    _check_sizes(request)
    if request.sensor not in SENSORS:
        raise OptionError(f"found {request.sensor!r}; valid: {', '.join(SENSORS)}", where="--sensor")
    _check_loads(request)
    _check_job(request)
    _check_arrays(request)
    if request.anchors_mm and request.pull_N is None:
        raise OptionError("ropes to anchors need forces; --pull-N 200,500 for instance", where="--anchors")


def _check_counts(r: PosesRequest) -> None:
    """Check counts: at least one of everything, and no excessive computing time."""
    for option, value, least in (
        ("--poses", r.poses, 1),
        ("--loads", r.loads, 1),
        ("--cycles", r.cycles, 1),
        ("--candidates", r.candidates, 1),
        ("--starts", r.starts, 1),
        ("--seed", r.seed, 0),
        ("--pull-directions", r.pull_directions, 1),
    ):
        if value < least:
            raise InputError(f"found {value}; expected at least {least}", where=option)
    for option, value, most in (
        ("--poses", r.poses, MOST_POSES),
        ("--loads", r.loads, MOST_LOADS),
        ("--cycles", r.cycles, MOST_CYCLES),
        ("--starts", r.starts, MOST_STARTS),
    ):
        if value > most:
            raise InputError(f"found {value}; expected at most {most}", where=option)
    if r.candidates < r.poses:
        raise OptionError(
            f"found {r.candidates}; fewer candidates than the {r.poses} poses wanted", where="--candidates"
        )


def _check_sizes(r: PosesRequest) -> None:
    """Check single numbers."""
    for option, number, strict in (
        ("--displacement-mm", r.displacement_mm, True),
        ("--targets-mm", r.targets_mm, True),
        ("--cycle-mm", r.cycle_mm, False),
        ("--pose-mm", r.pose_mm, False),
        ("--force-percent", r.force_percent, False),
        ("--target-percent", r.target_percent, True),
        ("--max-deflection-mm", r.max_deflection_mm, True),
        ("--max-load-N", r.max_load_N, True),
        ("--max-nu-p", r.max_nu_p, True),
        ("--max-nu-r-deg", r.max_nu_r_deg, True),
        ("--min-signal", r.min_signal, False),
        ("--clearance-mm", r.clearance_mm, False),
        ("--limit-margin-deg", r.limit_margin_deg, False),
        ("--tracker-range-mm", r.tracker_range_mm, True),
        ("--tracker-angle-deg", r.tracker_angle_deg, False),
        ("--min-kci", r.min_kci, False),
    ):
        if number is not None and not (isfinite(number) and (number > 0 if strict else number >= 0)):
            raise InputError(f"found {number:g}; expected {'more than' if strict else 'at least'} zero", where=option)
    if r.tracker_angle_deg >= 180:
        raise OptionError(f"found {r.tracker_angle_deg:g}; expected less than 180", where="--tracker-angle-deg")
    if r.min_kci >= 1:
        raise OptionError(f"found {r.min_kci:g}; a KCI lies between 0 and 1", where="--min-kci")
    if not r.floor_mm < r.ceiling_mm:
        raise OptionError(
            f"found {r.floor_mm:g}; expected less than --ceiling-mm, {r.ceiling_mm:g}", where="--floor-mm"
        )
    if not (isfinite(r.prior_factor) and r.prior_factor >= 1):
        raise OptionError(
            f"found {r.prior_factor:g}; expected 1 (the prior is trusted) or more", where="--prior-factor"
        )


def _check_loads(r: PosesRequest) -> None:
    """Check weights, pulls and lever arms."""
    for option, row in (("--weights-kg", r.weights_kg), ("--pull-N", r.pull_N)):
        for v in row or ():
            if not (isfinite(v) and v > 0):
                raise InputError(f"found {v:g}; expected more than zero", where=option)
    for v in r.arms_mm:
        if not (isfinite(v) and v >= 0):
            raise OptionError(f"found {v:g}; expected 0 (at the TCP) or the arm's length", where="--arms-mm")
    if not r.arms_mm:
        raise OptionError("is empty; 0 loads the TCP itself", where="--arms-mm")


def _check_job(r: PosesRequest) -> None:
    """Check the options of the job."""
    if r.force_N is not None and not (
        1 <= len(r.force_N) <= 2 and all(isfinite(v) and v >= 0 for v in r.force_N) and max(r.force_N) > 0
    ):
        found = ",".join(f"{v:g}" for v in r.force_N)
        raise OptionError(
            f"found {found}; expected the least and the largest process force, e.g. 200,800", where="--force-N"
        )
    if r.discriminate is not None and (r.toolpath is not None or r.force_N is not None):
        raise OptionError(
            "the diagnosis says which loads are needed; without --toolpath and --force-N it would work",
            where="--discriminate",
        )


def _check_arrays(r: PosesRequest) -> None:
    """Check positions, boxes and joint values: number of entries and plausible values."""
    for option, row, n in (
        ("--box-mm", r.box_mm, 6),
        ("--tracker", r.tracker_mm, 3),
        ("--max-torque-Nm", r.max_torque_Nm, 6),
        ("--prior", r.prior_Nm_per_rad, 6),
        *(("--anchors", a, 3) for a in r.anchors_mm),
    ):
        if row is not None and (len(row) != n or not all(isfinite(v) for v in row)):
            found = f"{len(row)} values" if len(row) != n else ",".join(f"{v:g}" for v in row)
            raise InputError(f"found {found}; expected {n} finite numbers", where=option)
    if r.box_mm is not None and not all(a < b for a, b in zip(r.box_mm[:3], r.box_mm[3:], strict=True)):
        raise OptionError(
            "the highest corner is not above the lowest; expected xmin,ymin,zmin,xmax,ymax,zmax", where="--box-mm"
        )
    for option, row in (("--prior", r.prior_Nm_per_rad), ("--max-torque-Nm", r.max_torque_Nm)):
        if row is not None and min(row) <= 0:
            raise InputError(f"found {min(row):g}; expected more than zero", where=option)
