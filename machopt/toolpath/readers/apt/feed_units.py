"""Units of feeds in APT files: of FEDRAT and of cycles."""

from __future__ import annotations

FEED_UNITS = {  # word → (mm per length unit, None: the file's), per revolution
    "MMPM": (1.0, False),
    "MMPR": (1.0, True),
    "IPM": (25.4, False),
    "IPR": (25.4, True),
    "PERMIN": (None, False),
    "PERREV": (None, True),
}
