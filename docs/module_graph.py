"""Numbers of the module graph, for docs/architecture.md: ``python docs/module_graph.py`` in the tree to be counted.

Late imports count, what only a type checker reads does not.
"""

from __future__ import annotations

import importlib.util
from collections import Counter
from pathlib import Path

import grimp
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

LONG = 400  # lines


def main() -> None:
    found = importlib.util.find_spec("machopt")
    folder = Path(str(found.origin if found else "")).parent
    graph = grimp.build_graph("machopt", exclude_type_checking_imports=True, cache_dir=None)
    names = sorted(graph.modules)
    number = {name: n for n, name in enumerate(names)}
    arrows = [(number[a], number[b]) for a in names for b in graph.find_modules_directly_imported_by(a)]
    rows, columns = np.array(arrows).T
    matrix = coo_array((np.ones(len(rows)), (rows, columns)), shape=(len(names),) * 2)
    _, part = connected_components(matrix, directed=True, connection="strong")
    circles = [n for n in Counter(part.tolist()).values() if n > 1]
    lines = {p: len(p.read_text(encoding="utf-8").splitlines()) for p in folder.rglob("*.py")}
    commands = [n for p, n in lines.items() if "commands" in p.relative_to(folder).parts[:1]]
    print("modules", len(names))
    print("imports", len(arrows))
    print("circles", len(circles), "of", sum(circles), "modules")
    print(f"files above {LONG} lines", sum(n > LONG for n in lines.values()))
    print("lines", sum(lines.values()), "in", len(lines), "files, the median", int(np.median(list(lines.values()))))
    print("commands", sum(commands), "lines in", len(commands), "files, the longest", max(commands))


if __name__ == "__main__":
    main()
