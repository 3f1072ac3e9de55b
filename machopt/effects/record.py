"""What is wrong with a recording and not with the arm: units, columns, single rows.

Sensors: :mod:`sensor`; clocks: :mod:`delay`.
"""

from __future__ import annotations

from machopt.effects.protocol import Effect

UNITS = Effect(
    name="units",
    noun="wrong unit",
    spoken="units",
    sentence="The column carries another unit than its name says.",
    port="record",
    places=(),
    of="in",
)

COLUMNS = Effect(
    name="columns",
    noun="wrong columns",
    spoken="columns",
    sentence="Signs, axes or rows of the columns are exchanged: what stands there belongs elsewhere.",
    port="record",
    places=(),
    of="in",
)

OUTLIERS = Effect(
    name="outliers",
    noun="outliers",
    spoken="outlying rows",
    sentence="Single readings that no physics explains: slips, slipped decimals, lost beams.",
    port="record",
    places=(),
    of="in",
)
