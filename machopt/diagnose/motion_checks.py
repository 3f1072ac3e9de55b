"""Is the record itself right? Units, motor side or joint side, channels that never change or saturate, clocks of q.

What can be put right is put right and said as a finding; what cannot is one clear error.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from machopt.diagnose.motion_signals import Motion, signals
from machopt.diagnose.problem import Array, RecordCorrection
from machopt.diagnose.result import Estimate, Finding
from machopt.domain.recording import Recording
from machopt.errors import InputError

Field = Literal["velocity", "torque", "q_secondary", "q_command", "position", "current"]
FIRST = {"velocity": "qd1_deg_s", "torque": "tau1_Nm", "q_secondary": "qse1_deg", "q_command": "qcmd1_deg",
         "position": "x_mm", "q": "q1_deg"}  # fmt: skip
FACTORS = {np.pi / 180.0: "radians for degrees", 180.0 / np.pi: "degrees twice", 1e-3: "a thousandth of the unit",
           1e3: "a thousand times the unit"}  # fmt: skip
NEAR = 0.08  # relative, of a slope to the factor of a unit
ALIKE = 0.9  # correlation from which a slope says something
MOTOR_SIDE = 0.2  # torque below this share of what the arm needs, joint by joint another: before the gear
CLIPPED = 0.01  # share of samples at the very largest value
LATE = 1e-3  # s; encoders that follow their command closer than this have no lag worth a word
EXPLAINS = 0.5  # of the tracking error's power


def slope(x: Array, y: Array) -> tuple[float, float]:
    """Slope of y over x through their means, and their correlation; 0, 0 where one does not change."""
    a, b = x - x.mean(), y - y.mean()
    xx, yy, xy = float(a @ a), float(b @ b), float(a @ b)
    if xx <= 0 or yy <= 0:
        return 0.0, 0.0
    return xy / xx, xy / float(np.sqrt(xx * yy))


def units(recording: Recording, joints: int) -> tuple[Recording, list[Finding]]:
    """Angles and speeds in another unit than the others: put right, and said."""
    found: list[Finding] = []
    for name in ("velocity", "q_secondary", "q_command"):
        values = getattr(recording, name)
        if values is None or recording.time is None:
            continue
        order = np.lexsort((recording.time, recording.session))
        q, x = recording.q[order, :joints], values[order, :joints]
        if name == "velocity":
            steps = np.diff(recording.time[order])
            good = (np.diff(recording.session[order]) == 0) & (steps > 0)
            q, x = (np.diff(q, axis=0)[good] / steps[good, None]), (0.5 * (x[1:] + x[:-1]))[good]
        pairs = [slope(q[:, j], x[:, j]) for j in range(joints) if np.isfinite(x[:, j]).all() and np.ptp(x[:, j]) > 0]
        sure = [s for s, r in pairs if abs(r) > ALIKE]
        if not sure:
            continue
        factor = float(np.median(sure))
        known = [f for f in FACTORS if abs(factor / f - 1.0) < NEAR]
        if known and max(abs(s / factor - 1.0) for s in sure) < NEAR:
            # all joints within a few degrees and everything else 57 times larger: the encoders are the odd ones
            odd = "q" if known[0] > 1.0 and np.abs(np.degrees(recording.q)).max() < 6.3 else name
            scale = known[0] if odd == "q" else 1.0 / known[0]
            recording = replace(recording, **{odd: getattr(recording, odd) * scale})
            found.append(_units(odd, 1.0 / scale, FACTORS[known[0]] if odd != "q" else "radians for degrees"))
        elif min(sure) < 0 < max(sure) or factor < 0:
            bad = [j + 1 for j, (s, r) in enumerate(pairs) if s < 0 and abs(r) > ALIKE]
            raise InputError(
                f"{recording.source}: {FIRST[name].replace('1', str(bad[0]))} runs against q{bad[0]}_deg; "
                "the same sign as the encoder would work"
            )
    return recording, found


def torque_side(recording: Recording, motion: Motion, predicted: Array) -> tuple[Recording, list[Finding], list[str]]:
    """Torque in another unit, or of the motors before their gears, against what the arm needs."""
    if recording.torque is None:
        return recording, [], []
    tau = recording.torque[motion.index, : predicted.shape[1]]
    needed = np.ptp(predicted, axis=0)
    pairs = [slope(predicted[:, j], tau[:, j]) for j in range(predicted.shape[1])]
    sure = [j for j, (s, r) in enumerate(pairs) if abs(r) > ALIKE and needed[j] > 0.02 * needed.max()]
    if len(sure) < min(2, predicted.shape[1]):
        return recording, [], []
    slopes = np.array([pairs[j][0] for j in sure])
    middle = float(np.median(slopes))
    known = [f for f in (1e-3, 1e3) if abs(middle / f - 1.0) < 0.5]
    if known and np.ptp(slopes) < 0.5 * abs(middle):
        factor = known[0]
        return (replace(recording, torque=recording.torque / factor), [_units("torque", factor, FACTORS[factor])], [])
    if np.all(np.abs(slopes) < MOTOR_SIDE):
        shares = ", ".join(f"{100 * pairs[j][0]:.2g} %" for j in sure)
        raise InputError(
            f"{recording.source}: tau{sure[0] + 1}_Nm is {shares} of what the arm needs at joints "
            f"{', '.join(str(j + 1) for j in sure)}: torque of the motors before their gears? Torque at the joint "
            "(times the gear ratio) would work"
        )
    warnings = []
    reversed_ = [j + 1 for j in sure if pairs[j][0] < 0]
    if reversed_:
        warnings.append(f"torque of joint {reversed_[0]} runs against what the arm needs: another sign than q?")
    return recording, [], warnings


def quality(recording: Recording, joints: int) -> list[str]:
    """Channels that never change, and torques cut off at a limit."""
    out = []
    for name in ("velocity", "torque"):
        values = getattr(recording, name)
        if values is None:
            continue
        for j in range(joints):
            x, label = values[:, j], FIRST[name].replace("1", str(j + 1))
            if np.ptp(x) == 0 and np.ptp(recording.q[:, j]) > 2e-3:
                out.append(f"{label} never changes though joint {j + 1} moves")
                continue
            if name == "torque":
                top = np.abs(x).max()
                share = float(np.mean(np.abs(x) >= top * (1.0 - 1e-9)))
                if top > 0 and share > CLIPPED:
                    out.append(f"{label} is at ±{top:.4g} in {100 * share:.1f} % of the samples: cut off at a limit")
    if recording.velocity is not None and all("never changes" in w for w in out) and len(out) >= joints > 0:
        raise InputError(f"{recording.source}: no column qd1_deg_s … changes though the arm moves")
    return out


def following(recording: Recording, joints: int) -> tuple[Array, float, Array]:
    """How the encoders follow the command: delays (n,) s, share explained, rms before and after (2,) rad."""
    m = signals(recording, joints)
    assert recording.q_command is not None
    asked = recording.q_command[m.index, :joints]
    speed = m.differentiate(asked)
    out, before, after = np.zeros(joints), 0.0, 0.0
    for j in range(joints):
        behind = asked[:, j] - m.q[:, j]
        behind = behind - behind.mean()
        x = speed[:, j] - speed[:, j].mean()
        if np.ptp(asked[:, j]) < 2e-3 or not float(x @ x) > 0:
            continue
        out[j] = float(x @ behind) / float(x @ x)
        before += float(np.mean(behind**2))
        after += float(np.mean((behind - out[j] * x) ** 2))
    share = 1.0 - after / before if before > 0 else 0.0
    return out, share, np.sqrt(np.array([before, after]) / joints)


def servo_lag(recording: Recording, joints: int) -> list[Finding]:
    """The encoders stay behind the command in proportion to speed; said where the channel itself does not show it."""
    if recording.q_command is None:
        return []
    delay, share, rms = following(recording, joints)
    moving = delay[np.abs(delay) > 0]
    if not len(moving) or share < EXPLAINS or abs(float(np.mean(moving))) < LATE:
        return []
    mean = 1e3 * float(np.mean(moving))
    parameters = {"delay": _exact(mean, "ms", 1e3 * float(np.std(moving)) / np.sqrt(len(moving)))}
    parameters |= {f"delay_{j + 1}": _exact(1e3 * float(d), "ms", 0.0) for j, d in enumerate(delay)}
    return [
        Finding(
            "servo_lag", "controller", "encoders behind the command", "q(t) = q_command(t − T), joint by joint",
            "in proportion to speed", (("servo_lag", "controller"), ("time_skew", "sensor:qcmd")), parameters,
            1e3 * float(rms[0]), 1e3 * float(rms[1]), 1e-6,
            correction=RecordCorrection("servo_lag", "controller", {"delay_ms": (1e3 * delay).tolist()}),
        )
    ]  # fmt: skip


def _exact(value: float, unit: str, sigma: float) -> Estimate:
    return Estimate(
        value, unit, (value - 1.645 * sigma, value + 1.645 * sigma), (value - 1.96 * sigma, value + 1.96 * sigma)
    )


def _units(field: str, factor: float, words: str) -> Finding:
    where = f"column:{FIRST[field]}"
    return Finding(
        "units", where, words, "column = factor × what its name says", "in the record, not in the robot",
        (("units", where),), {"factor": _exact(factor, "1", 0.0)}, float("nan"), float("nan"), 1e-6,
        correction=RecordCorrection("units", where, {"factor": factor}), record=True,
    )  # fmt: skip
