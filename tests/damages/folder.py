"""Damages of the folder itself: files that are gone, added, cut or changed; a manifest or a result that lies."""

from __future__ import annotations

from pathlib import Path

from damages.damage import Damage, edited, one

DAMAGES = [
    Damage("points.csv removed", "1 file", lambda job: (job.out / "points.csv").unlink(), "files as listed",
           reseal=False),
    Damage("a stray file", "1 file", lambda job: (job.out / "notes.txt").write_text("x") and None, "files as listed",
           reseal=False),
    Damage("a program cut in half", "50 %", lambda job: _cut(one(job.out, "*.src"), 0.5), "files as listed",
           reseal=False),
    Damage("manifest: collision switched off afterwards", "1 word",
           edited("manifest.json", lambda m: m["options"].update(collision=False)), "manifest.json", reseal=False,
           as_is="manifest.json"),
]  # fmt: skip


def _cut(file: Path, share: float) -> None:
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
