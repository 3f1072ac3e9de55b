"""Warm-up of an arm: motors heat gear boxes, gear boxes heat links; two time constants and the hall's own day.

    C_m Ṫ_m = P(t) − (T_m − T_l)/R_ml          (motor and gear box)
    C_l Ṫ_l = (T_m − T_l)/R_ml − (T_l − T_hall)/R_la     (link)

A link grows by α L (T_l − T_0). A link in the sun is warmer on one side: it bows by κ L²/8 and turns its end by κ L.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ALPHA = 1.2e-5  # 1/K, cast iron and steel


@dataclass(frozen=True)
class Heat:
    """Thermal state of an arm."""

    links: tuple[int, ...]  # that grow
    length: Array  # (6,) m of links 1 … 6
    rise: float  # K, of the links at full warm-up
    fast: float  # s, motor and gear box
    slow: float  # s, link
    swing: float  # K, half the daily change of the hall
    sun: Array | None = None  # (2,) rad of bow at noon about the two cross axes of the only link
    gain: float = 1.0
    work: float = 9000.0  # s of a session before the robot rests

    def temperatures(self, time: Array) -> tuple[Array, Array]:
        """Link rise (B,) K and hall (B,) °C at times (B,) s; the robot rests overnight."""
        day = np.mod(time, 86400.0)
        span = np.arange(0.0, max(float(time.max()), 1.0) + 60.0, 5.0)
        power = (np.mod(span, 57600.0) < self.work).astype(float)  # sessions begin 16 h apart
        hall = 21.0 + self.swing * np.sin(2 * np.pi * day / 86400.0)
        motor, link = np.zeros_like(span), np.zeros_like(span)
        for k in range(1, len(span)):
            dt = span[k] - span[k - 1]
            motor[k] = motor[k - 1] + dt * (power[k - 1] - motor[k - 1]) / self.fast
            link[k] = link[k - 1] + dt * (motor[k - 1] - link[k - 1]) / self.slow
        return self.gain * self.rise * np.interp(time, span, link), hall

    def growth(self, time: Array) -> dict[int, tuple[Array, Array]]:
        """Lengthening (B,) m and bow (B, 2) rad of each link."""
        rise, hall = self.temperatures(time)
        out = {}
        for link in self.links:
            length = ALPHA * self.length[link - 1] * (rise + self.gain * (hall - 21.0) * (self.sun is None))
            bow = np.zeros((len(time), 2))
            if self.sun is not None:
                # clouds: the sun comes and goes over tens of minutes
                sun = np.clip(np.sin(2 * np.pi * time / 5200.0) + 0.4 * np.sin(2 * np.pi * time / 1700.0), 0, None)
                bow = self.gain * sun[:, None] * self.sun
                length = 0.0 * length
            out[link] = (length, bow)
        return out
