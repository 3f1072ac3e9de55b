"""Compiles machopt's kernels while its wheel is built, so that the first run after `pip install` need not.

The wheel brings machine code for the processor it was built on; on another one, or with another numba or Python, it
is not used, and kernels are compiled on the first run. MACHOPT_KERNELS=0 builds a wheel without. Nothing here may fail
a build.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PROCESSES = 4  # at most
MEMORY = "NUMBA_CACHE_DIR"


class Kernels(BuildHookInterface):  # type: ignore[type-arg]
    """Adds the folder ``machopt/kernels`` to a wheel."""

    made: Path | None = None

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, in as many processes as there are cores."""
        if version != "standard" or os.environ.get("MACHOPT_KERNELS") == "0":
            return
        self.made = Path(tempfile.mkdtemp(prefix="machopt-kernels-"))
        into = self.made / "kernels"
        into.mkdir()
        count = max(1, min(PROCESSES, os.cpu_count() or 1))
        self.app.display_waiting(f"compiling kernels for this processor, in {count} processes")
        found_by = os.pathsep.join(
            [self.root, *filter(None, [os.environ.get("PYTHONPATH")])]
        )  # pip's isolation is in it
        env = {**os.environ, "PYTHONPATH": found_by, MEMORY: str(self.made / "numba")}
        words = [sys.executable, "-m", "machopt.planning.kernel_precompilation", str(into)]
        runs = []
        try:
            for _ in range(count):
                runs.append(subprocess.Popen(words, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE))
            said = [run.communicate()[1].decode(errors="replace") for run in runs]
        except OSError as e:
            said = [str(e)]
        if len(runs) < count or any(run.returncode for run in runs):
            why = next((text.strip().splitlines()[-1] for text in said if text.strip()), "no reason was given")
            self.app.display_warning(f"kernels were not compiled, the first run will do it: {why}")
        found = sorted(into.glob("*.machine"))
        build_data["force_include"].update({str(file): f"machopt/kernels/{file.name}" for file in found})

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """The wheel has its own."""
        if self.made is not None:
            shutil.rmtree(self.made, ignore_errors=True)
