"""What every channel shares: a record without noise, its own base refit, how loud an effect is beside noise."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from dual_quaternions import Array

Named = tuple[str, str]


@dataclass(frozen=True)
class NoiseFreeRecord:
    """A record before noise.

    ``y`` (N, D) is what is predicted, in m or rad or N·m; ``base`` (N, D, P) its columns per parameter of the refitted
    base; ``sigma`` (N, D) 1 sigma of a reading, ``shared`` (N, D) of what a group shares; ``groups`` (N,).
    """

    columns: dict[str, Array]
    y: Array
    base: Array
    sigma: Array
    shared: Array
    groups: Array

    def white(self, x: Array) -> Array:
        """(N, D, K) columns turned so that the noise of all rows is 1 and independent (up to tails), flat (N·D, K)."""
        scaled = x / self.sigma[..., None]
        ratio = np.mean((self.shared / self.sigma) ** 2, axis=0)  # (D,)
        labels, which, counts = np.unique(self.groups, return_inverse=True, return_counts=True)
        mean = np.zeros((len(labels), *scaled.shape[1:]))
        np.add.at(mean, which, scaled)
        mean /= counts[:, None, None]
        # a share of each group's mean goes: 1 - 1/sqrt(1 + n r)
        part = 1.0 - 1.0 / np.sqrt(1.0 + counts[:, None] * ratio[None, :])
        out = scaled - (part[..., None] * mean)[which]
        return out.reshape(-1, x.shape[-1])

    def left(self, y: Array | None = None, more: Array | None = None) -> Array:
        """White residual (N·D,) of ``y`` after the base, and ``more`` columns (N, D, K), are refitted."""
        X = self.base if more is None else np.concatenate([self.base, more], axis=2)
        A = self.white(X)
        A = A / np.maximum(np.linalg.norm(A, axis=0), 1e-30)
        b = self.white((self.y if y is None else y)[..., None])[:, 0]
        return np.asarray(b - A @ np.linalg.lstsq(A, b, rcond=1e-10)[0])

    def unexplained(self) -> Array:
        """(N, D) of ``y`` that the base does not give, in its own unit."""
        A, b = self.white(self.base), self.white(self.y[..., None])[:, 0]
        size = np.maximum(np.linalg.norm(A, axis=0), 1e-30)
        x = np.linalg.lstsq(A / size, b, rcond=1e-10)[0] / size
        return np.asarray(self.y - self.base @ x)


@dataclass
class Effect:
    """Something concealed: where, how large, and how its truth is told."""

    effect: str
    location: str
    amplitude: float  # in the effect's own unit
    cap: float  # largest that is physical
    unit: str = ""  # of size, "" where no detection limit is comparable
    factor: float = 1.0  # size in ``unit`` per amplitude
    parameter: str = ""  # parameter of the truth that an interval may hold; size is its value
    accepted: tuple[Named, ...] = ()  # identities of mechanics
    detail: dict[str, Any] = field(default_factory=dict)
    loudness: float = 0.0  # r.m.s. wanted of what is left after the refit, in sigmas
    is_before_refit: bool = False  # ``loudness`` is what the effect adds before the base is refitted

    def size(self) -> float:
        return self.amplitude * self.factor


class Scene(Protocol):
    """One channel's experiment."""

    channel: str
    unit: str

    def clean(self, effects: list[Effect]) -> NoiseFreeRecord:
        """The noise-free record with these effects in it."""

    def rivals(self, clean: NoiseFreeRecord) -> dict[Named, Array]:
        """Columns (N, D, K) of other explanations."""


def loudness(scene: Scene, effect: Effect, quiet: NoiseFreeRecord) -> tuple[float, float, Array]:
    """R.m.s. in sigmas before and after the refit, and the white rest (N·D,) of what the effect adds."""
    loud = scene.clean([effect])
    rest = loud.left() - quiet.left()
    before = loud.white((loud.y - quiet.y)[..., None])[:, 0]
    return float(np.sqrt(np.mean(before**2))), float(np.sqrt(np.mean(rest**2))), rest


def scale_effect(scene: Scene, effect: Effect, quiet: NoiseFreeRecord) -> float:
    """Set the amplitude so that ``effect.loudness`` sigmas are reached, or the cap; return what is reached."""
    after = 0.0
    for _ in range(5):
        before, after, _ = loudness(scene, effect, quiet)
        after = before if effect.is_before_refit else after
        if after <= 0 or abs(np.log(after / effect.loudness)) < 0.05:
            break
        wanted = effect.amplitude * float(np.clip(effect.loudness / after, 0.02, 50.0))
        if abs(wanted) >= effect.cap and abs(effect.amplitude) >= effect.cap:
            break
        effect.amplitude = float(np.sign(wanted) * min(abs(wanted), effect.cap))
    return after


def list_accepted_names(scene: Scene, effect: Effect, quiet: NoiseFreeRecord) -> tuple[list[Named], dict[str, float]]:
    """All names no test on this record could tell apart, and how loud the effect is."""
    loud = scene.clean([effect])
    own = (effect.effect, effect.location)
    rest = loud.left() - quiet.left()
    # what finite motions leave of a quiet arm is no rival's to explain
    mended = loud.y - quiet.unexplained()
    names: list[Named] = [own, *effect.accepted]
    strength = float(np.linalg.norm(rest))
    for name, columns in scene.rivals(loud).items():
        # powerless for the best test there is, and below a tenth of what it explains
        if name not in names and float(np.linalg.norm(loud.left(mended, columns))) < min(2.0, 0.3 * strength):
            names.append(name)
    difference = loud.y - quiet.y
    before = float(np.sqrt(np.mean(difference**2)))
    return names, {
        "noncentrality": strength,
        "rms_before": before,
        "rms_after_sigma": float(np.sqrt(np.mean(rest**2))),
        "before_sigma": float(np.sqrt(np.mean(loud.white(difference[..., None]) ** 2))),
    }
