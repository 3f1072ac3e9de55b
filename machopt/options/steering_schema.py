"""Steering rules of a plan as the user writes them: one entry of ``steer``."""

from __future__ import annotations

from math import degrees, radians

from pydantic import Field, model_validator

from machopt.data_types.plan_options import SteeringRule
from machopt.file_formats.strict_yaml import StrictSchema


class SteerKeys(StrictSchema):
    """A wish about some places: an operation where it cuts, a point, points, or (none of these) the whole path."""

    operation: str | None = Field(default=None, description="label of the operation it is about, where that cuts")
    point: int | None = Field(default=None, ge=0, description="0-based index of a toolpath point")
    points: list[int] | None = Field(
        default=None, min_length=2, max_length=2, description="[first, last] of several toolpath points"
    )
    gamma_deg: float | None = Field(default=None, ge=-180, le=180, description="pin: the rotation there")
    forbid_deg: list[float] | None = Field(
        default=None,
        min_length=2,
        max_length=2,
        description="zone [from, to] of rotations to keep out of, or of the external joint",
    )
    prefer_deg: float | None = Field(default=None, ge=-180, le=180, description="rotation that is preferred there")
    weight: float | None = Field(default=None, ge=0, description="price of a deviation of 180 degrees from it (0.1)")
    branch: int | None = Field(default=None, ge=0, description="the only branch (points.csv) to use there")
    external: str | None = Field(
        default=None, description="an external joint, by name or as e1, e2 …: the entry is about it, not the rotation"
    )
    at_mm: float | None = Field(default=None, description="fixed position of the external joint there, mm")
    at_deg: float | None = Field(default=None, description="the same of a joint that turns, degrees")
    forbid_mm: list[float] | None = Field(
        default=None, min_length=2, max_length=2, description="zone [from, to] of the external joint, mm"
    )

    @model_validator(mode="after")
    def _check_one_place(self) -> SteerKeys:
        given = [k for k in ("operation", "point", "points") if getattr(self, k) is not None]
        if len(given) > 1:
            raise ValueError(f"found {' and '.join(given)}; exactly one of them gives the position")
        if self.external is not None:
            self._check_joint_rule()
            return self
        joint = [k for k in ("at_mm", "at_deg", "forbid_mm") if getattr(self, k) is not None]
        if joint:
            raise ValueError(f"{joint[0]}: of an external joint, which external: names; it is not given")
        wishes = ("gamma_deg", "forbid_deg", "prefer_deg", "branch")
        if all(getattr(self, k) is None for k in wishes):
            raise ValueError(f"is empty; expected one of {', '.join(wishes)}")
        if self.weight is not None and self.prefer_deg is None:
            raise ValueError("weight: is of prefer_deg, which is not given")
        if self.points is not None and not 0 <= self.points[0] <= self.points[1]:
            raise ValueError(f"points: found {self.points}; expected [first, last] with 0 ≤ first ≤ last")
        zone = self.forbid_deg
        if zone is not None and (any(abs(v) > 180 for v in zone) or (zone[1] - zone[0]) % 360 == 0):
            raise ValueError(
                f"forbid_deg: found {zone}; expected [from, to] within -180 … 180, two angles "
                "([170, -170] leads through 180)"
            )
        return self

    def _check_joint_rule(self) -> None:
        """Refuse what is not about one external joint in one unit."""
        keys = ("at_mm", "at_deg", "forbid_mm", "forbid_deg")
        given = [k for k in keys if getattr(self, k) is not None]
        turned = [k for k in ("gamma_deg", "prefer_deg", "weight", "branch") if getattr(self, k) is not None]
        if turned:
            raise ValueError(
                f"{turned[0]}: of the rotation, together with external: {self.external}; two entries would work"
            )
        if len(given) != 1:
            raise ValueError(
                f"found {' and '.join(given) or 'no place'} for external: {self.external}; one of {', '.join(keys)} "
                "gives its position, or never does"
            )
        zone = self.forbid_mm or self.forbid_deg
        if zone is not None and not zone[0] < zone[1]:
            raise ValueError(f"{given[0]}: found {zone}; expected [from, to] with from < to")
        if self.points is not None and not 0 <= self.points[0] <= self.points[1]:
            raise ValueError(f"points: found {self.points}; expected [first, last] with 0 ≤ first ≤ last")


def format_steering(wish: SteeringRule) -> dict[str, object]:
    """Format a steering rule under the user's keys and units.

    Args:
        wish: The rule, SI units.

    Returns:
        Key → value.
    """
    out: dict[str, object] = {}
    if wish.operation:
        out["operation"] = wish.operation
    elif wish.points is not None:
        first, last = wish.points
        out |= {"point": first} if first == last else {"points": [first, last]}
    if wish.joint:
        out["external"] = wish.joint
        per = degrees if wish.unit == "deg" else _convert_to_mm
        if wish.at is not None:
            out[f"at_{wish.unit}"] = round_to_user_digits(per(wish.at))
        if wish.away is not None:
            out[f"forbid_{wish.unit}"] = [round_to_user_digits(per(v)) for v in wish.away]
    if wish.gamma is not None:
        out["gamma_deg"] = round_to_user_digits(degrees(wish.gamma))
    if wish.forbid is not None:
        out["forbid_deg"] = [round_to_user_digits(degrees(v)) for v in wish.forbid]
    if wish.prefer is not None:
        out |= {"prefer_deg": round_to_user_digits(degrees(wish.prefer)), "weight": wish.weight}
    if wish.branch is not None:
        out["branch"] = wish.branch
    return out


def parse_steering(keys: SteerKeys) -> SteeringRule:
    """Convert a steering rule to SI.

    Args:
        keys: Validated keys of one entry of ``steer``.

    Returns:
        The rule.
    """
    si: dict[str, object] = {} if keys.weight is None else {"weight": keys.weight}
    if keys.point is not None:
        si["points"] = (keys.point, keys.point)
    elif keys.points is not None:
        si["points"] = (keys.points[0], keys.points[1])
    if keys.external is not None:
        slides = keys.at_mm is not None or keys.forbid_mm is not None
        at, zone = (keys.at_mm, keys.forbid_mm) if slides else (keys.at_deg, keys.forbid_deg)
        per = _convert_to_m if slides else radians
        si |= {"joint": keys.external, "unit": "mm" if slides else "deg"}
        si |= {"at": None if at is None else per(at), "away": None if zone is None else (per(zone[0]), per(zone[1]))}
    elif keys.forbid_deg is not None:
        si["forbid"] = (radians(keys.forbid_deg[0]), radians(keys.forbid_deg[1]))
    return SteeringRule(
        operation=keys.operation or "",
        gamma=None if keys.gamma_deg is None else radians(keys.gamma_deg),
        prefer=None if keys.prefer_deg is None else radians(keys.prefer_deg),
        branch=keys.branch,
        **si,  # type: ignore[arg-type]
    )


def _convert_to_m(mm: float) -> float:
    return mm * 1e-3


def _convert_to_mm(m: float) -> float:
    return m * 1e3


def round_to_user_digits(value: float) -> float:
    """Round to twelve significant digits, which survive the conversion to SI and back.

    Args:
        value: The converted number.

    Returns:
        The rounded number.
    """
    return float(f"{value:.12g}")
