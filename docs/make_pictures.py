"""The README's pictures, taken of reports in a headless Chromium: ``python docs/make_pictures.py REPORT.html``.

They are pictures of what the command wrote, not drawings: run it again when the report changes.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
WIDTH, HEIGHT = 1180, 1840  # CSS pixels: verdict, robot and map of the report
COLOURS = 160  # a palette: a third of the bytes, nothing that one would see
PICTURE = Path(__file__).parent / "report.png"


def picture(report: Path) -> bytes:
    """The upper part of a report as PNG.

    Raises:
        SystemExit: there is no browser, or it drew nothing.
    """
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        sys.exit(f"no browser: none of {', '.join(BROWSERS)} is on the path")
    with tempfile.TemporaryDirectory() as folder:
        shot = Path(folder) / "shot.png"
        subprocess.run(
            [
                browser,
                "--headless",
                "--no-sandbox",
                "--use-angle=swiftshader",
                "--enable-unsafe-swiftshader",
                "--hide-scrollbars",
                "--blink-settings=preferredColorScheme=1",
                f"--window-size={WIDTH},{HEIGHT}",
                f"--user-data-dir={folder}/profile",
                "--virtual-time-budget=8000",
                f"--screenshot={shot}",
                report.resolve().as_uri(),
            ],
            check=True,
            capture_output=True,
            timeout=120,
        )
        if not shot.exists():
            sys.exit(f"{browser} drew nothing of {report}")
        drawn = Image.open(shot).convert("RGB").quantize(COLOURS)
        packed = io.BytesIO()
        drawn.save(packed, "PNG", optimize=True)
    return packed.getvalue()


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(f"usage: {sys.argv[0]} REPORT.html")
    drawn = picture(Path(sys.argv[1]))
    PICTURE.write_bytes(drawn)
    print(f"{PICTURE}: {len(drawn) / 1024:.0f} KiB")
