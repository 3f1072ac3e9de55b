"""Every kind of page checked with the WCAG rules of axe-core: narrow and wide, light and dark."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from browser_driver import Browser
from sample_pages import pages

AXE = Path(__file__).with_name("axe_core")
RULES = """axe.run(document, { resultTypes: ["violations"] }).then(r => r.violations.map(
    v => `${v.id} (${v.impact}), ${v.nodes.length} times: ${v.nodes[0].html.slice(0, 160)}`))"""
WIDE = "document.documentElement.scrollWidth - innerWidth"
ODD = r"(document.body.innerText.match(/\bNaN\b|Infinity|undefined|\[object|[-−]0(\.0+)?(?![\d.])/g) || []).slice(0, 5)"


def test_accessibility_rules_are_the_published_ones() -> None:
    """axe-core 4.14.1 from the npm registry: MPL-2.0, unchanged, with its licences, not part of any wheel."""
    published = {
        "LICENSE": "af175b9d96ee93c21a036152e1b905b0b95304d4ae8c2c921c7609100ba8df7e",
        "LICENSE-3RD-PARTY.txt": "4f8563870d0fca38bbc3e00b6f670cb7fa9f380ba9f26a7f7d1184a6b18b1653",
        "axe.min.js": "29348999450cdf2849a8e70b7912fc2da85a849da39c0d0d5394f51d4a9ed95c",
    }
    assert {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in AXE.iterdir()} == published


@pytest.mark.slow
@pytest.mark.parametrize(("widths", "dark"), [((1440, 2560), False), ((420, 900), True)])
def test_every_page_passes_accessibility_rules_and_loads_nothing(
    widths: tuple[int, int], dark: bool, tmp_path: Path
) -> None:
    rules = (AXE / "axe.min.js").read_text(encoding="utf-8")
    broken: dict[str, object] = {}
    with Browser(widths[0], 900, dark=dark) as browser:
        for name, html in pages(tmp_path):
            file = tmp_path / "page.html"
            file.write_text(html, encoding="utf-8")
            browser.complaints.clear()
            browser.requests.clear()
            browser.page.set_viewport_size({"width": widths[0], "height": 900})
            browser.open(file)
            browser.script(f"{rules};0")
            found: dict[str, object] = {}
            for width in widths:  # the page is loaded once and redrawn for each width
                browser.page.set_viewport_size({"width": width, "height": 900})
                browser.page.wait_for_timeout(150)
                found[f"rules at {width} px"] = browser.script(RULES)
                found[f"px wider than {width}"] = max(0, browser.script(WIDE))
            found |= {
                "no numbers": browser.script(ODD),
                "console": [c for c in browser.complaints if "timings.js" not in c],
                "asked for": [
                    r
                    for r in browser.requests
                    if r != file.as_uri() and not r.startswith(("data:", "blob:")) and not r.endswith("/timings.js")
                ],
            }
            broken |= {f"{name}: {what}": message for what, message in found.items() if message}
    assert broken == {}
