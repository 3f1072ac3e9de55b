"""What stands between a joint and the number that its drive tells: a gear that is driven through another joint.

The motor of joint j sits behind joint i, and its shaft runs through it: where joint i turns and the motor stands
still, joint j turns back. In angles of joints the motor turns by phi_j = q_j + ratio q_i; by power, what the motors
give is the inverse transpose of that on the joints' torques. Its friction and its rotor go with phi_j. A controller
tells the torque of each motor, or what all of them do to each joint.
"""

from __future__ import annotations

import numpy as np
from dual_quaternions import Array
from effect_strength import Effect

WRISTS = ((4, 5), (3, 4), (3, 5))  # joint that the shaft runs through, joint that it drives, from 0
LARGEST = 1.0  # turns of the driven joint per turn of the other: a shaft at the joint's own speed


def compute_coupling_torque(
    speed: Array,
    acceleration: Array,
    torque: Array,
    i: int,
    j: int,
    ratio: float,
    drive: tuple[float, float, float, float],
    *,
    by_motors: bool,
) -> Array:
    """(N, 6) N m beyond what uncoupled drives would tell.

    ``drive``: dry and viscous friction of motor j, its rotor (kg m2 at the joint), the speed over which dry friction
    turns over.
    """
    coulomb, viscous, rotor, sharp = drive
    along = speed[:, j] + ratio * speed[:, i]
    own = coulomb * np.tanh(speed[:, j] / sharp) + viscous * speed[:, j]
    rubs = coulomb * np.tanh(along / sharp) + viscous * along
    rubs = rubs + rotor * (acceleration[:, j] + ratio * acceleration[:, i])
    out = np.zeros_like(torque)
    out[:, j] = rubs - own
    out[:, i] = -ratio * torque[:, j] if by_motors else ratio * rubs
    return out


def wrists(acceleration: Array, coulomb: Array, rng: np.random.Generator) -> list[Effect]:
    """Candidates, whichever way a controller tells its torques."""
    out = []
    for k in rng.permutation(len(WRISTS)):
        i, j = WRISTS[k]
        detail = {
            "joint": j,
            "runs_through": i,
            "shaft": 1,
            "sign": float(rng.choice([-1, 1])),
            "by_motors": bool(rng.integers(2)),
            "rotor": 0.4 * float(coulomb[j] / np.sqrt(np.mean(acceleration[:, j] ** 2))),
        }
        where = f"joint:{i + 1}-{j + 1}"
        out.append(Effect("joint_coupling", where, 0.3, LARGEST, "rad/rad", 1.0, "ratio", detail=detail))
    return out
