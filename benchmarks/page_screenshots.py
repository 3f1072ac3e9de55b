"""Pages as people see them, at three widths, light and dark: ``python benchmarks/page_screenshots.py PAGE.html|OUT … -o
FOLDER``.

A long page is cut into columns that stand side by side, so that one picture holds what three screens would; what is
wider than the window is told. Look at every picture: scripts find what overflows, not what is ugly or says the wrong
thing.
"""

from __future__ import annotations

import argparse
import io
import sys
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from browser_driver import Browser

COLUMNS = {420: 5, 900: 2, 1440: 1}  # window width in CSS pixels → columns of a picture
TALL = 1700  # px, of a column
WIDE = "document.documentElement.scrollWidth - innerWidth"
MOST = 24_000  # px of a page that are looked at


def strips_of(browser: Browser) -> list[Image.Image]:
    """A page screen by screen: whole, a long one would begin anew where the browser's largest texture ends."""
    browser.page.set_viewport_size({"width": browser.script("innerWidth"), "height": TALL})
    tall, strips = min(browser.script("document.documentElement.scrollHeight"), MOST), []
    for y in range(0, tall, TALL):
        browser.script(f"scrollTo(0, {y})")
        browser.page.wait_for_timeout(150)
        strip = Image.open(io.BytesIO(browser.page.screenshot())).convert("RGB")
        strips.append(strip.crop((0, TALL - min(TALL, tall - y), strip.width, TALL)))
    return strips


def cut(strips: list[Image.Image], columns: int) -> list[Image.Image]:
    """Pictures of so many columns each."""
    made = []
    for first in range(0, len(strips), columns):
        some = strips[first : first + columns]
        width = some[0].width + 12
        sheet = Image.new("RGB", (len(some) * width, max(s.height for s in some)), "magenta")
        for k, strip in enumerate(some):
            sheet.paste(strip, (k * width, 0))
        made.append(sheet)
    return made


def photographed(pages: list[Path], into: Path) -> None:
    """Every page, width and theme."""
    into.mkdir(parents=True, exist_ok=True)
    for width, columns in COLUMNS.items():
        for dark in (False, True):
            with Browser(width, 900, dark=dark) as browser:
                for page in pages:
                    browser.complaints.clear()
                    browser.open(page)
                    browser.page.wait_for_timeout(400)
                    of = page.parent.name if page.stem in ("report", "summary") else page.stem
                    name = f"{of}-{width}-{'dark' if dark else 'light'}"
                    for k, sheet in enumerate(cut(strips_of(browser), columns)):
                        sheet.save(into / f"{name}-{k}.png")
                    over = browser.script(WIDE)
                    print(name, f"{over} px too wide" if over > 0 else "", *browser.complaints)


if __name__ == "__main__":
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("page", nargs="+", type=Path, help="a page, or an output folder that holds report.html")
    words.add_argument("-o", "--out", type=Path, required=True, help="folder of the pictures")
    given = words.parse_args()
    photographed([(p / "report.html" if p.is_dir() else p).resolve() for p in given.page], given.out)
