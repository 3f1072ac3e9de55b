"""Request of ``machopt diagnose``."""

from __future__ import annotations

from dataclasses import dataclass
from os.path import isfile
from pathlib import Path

from machopt.errors import OptionError

DEFAULT_MAX_FINDINGS = 3  # most effects of forward selection in a motion
DEFAULT_MAX_STATIC_FINDINGS = 6  # static recordings with loads in many directions support more


@dataclass(frozen=True, kw_only=True)
class DiagnoseRequest:
    """Options of one run."""

    cell: Path
    recordings: tuple[Path, ...]
    out: Path
    channel: str = "auto"
    toolpath: Path | None = None
    terms: tuple[Path, ...] = ()  # Python files with laws of the user's own
    max_findings: int | None = None  # None: see most(); together, poses name more of them, unless it is 1 or 2
    accept: tuple[str, ...] = ()
    seed: int = 0
    tables: str = "csv"  # parquet: every table as Parquet, too
    overwrite: bool = False  # replace an earlier output though files in it were edited or added
    allow_external: bool = False
    overrides: tuple[str, ...] = ()  # planning options for the toolpath, key=value

    def get_max_findings(self, kind: str) -> int:
        """Return the largest number of effects of forward selection.

        Args:
            kind: Kind of the recording.

        Returns:
            Number of effects.
        """
        if self.max_findings is not None:
            return self.max_findings
        return DEFAULT_MAX_FINDINGS if kind == "motion" else DEFAULT_MAX_STATIC_FINDINGS

    def list_options(self, kind: str) -> dict[str, str | int | list[str]]:
        """Return the options that determine the result, as stated in result and report.

        Args:
            kind: Kind of the recording.

        Returns:
            Options by name.
        """
        given_options: dict[str, str | int | list[str]] = {
            "channel": self.channel,
            "max_findings": self.get_max_findings(kind),
            "seed": self.seed,
            "accept": list(self.accept),
            "terms": [p.name for p in self.terms],
        }
        return given_options | ({"set": list(self.overrides)} if self.toolpath and self.overrides else {})


def check_diagnose_request(request: DiagnoseRequest, kind: str) -> None:
    """Check a request against the kind of the recording before the long computation.

    Args:
        request: The request.
        kind: Kind of the recording.

    Raises:
        InputError: Names the option, the value found and what would be accepted.
    """
    if request.toolpath is not None and not isfile(request.toolpath):
        raise OptionError(
            "there is no such file; a toolpath that optimize reads would work",
            file=request.toolpath,
            where="--toolpath",
        )
    if request.channel != "auto" and kind != "motion":
        raise OptionError(
            f"found {request.channel}; channels are of a motion, this recording is of kind {kind!r}",
            where="--channel",
        )
