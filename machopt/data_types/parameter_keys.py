"""Keys of model parameters: what code compares, as opposed to the names that people read."""

from __future__ import annotations

from dataclasses import dataclass

from machopt.data_types.effect_locations import format_joint_location, parse_location

JOINT_SPRING = "joint_spring"  # the linear spring of each joint, which every model has


@dataclass(frozen=True)
class ParameterKey:
    """One number of one effect at one place."""

    effect: str  # a word of the vocabulary, or JOINT_SPRING
    location: str  # e.g. "joint:3"
    coefficient: str  # as files call it, e.g. "compliance_rad_per_Nm"

    @property
    def joint(self) -> int:
        """Of a place at one joint its number, from 1.

        Raises:
            ValueError: another place.
        """
        place = parse_location(self.location)
        if not place.is_joint_location or len(place.numbers) != 1:
            raise ValueError(f"{self.location} is no single joint")
        return place.numbers[0]


def build_joint_spring_key(joint: int) -> ParameterKey:
    """Return the key of a joint's compliance.

    Args:
        joint: The joint, counted from 1.
    """
    return ParameterKey(JOINT_SPRING, format_joint_location(joint), "compliance_rad_per_Nm")
