"""One job of a batch and what is known of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from machopt.batch.job_discovery import BatchJob


@dataclass(frozen=True, kw_only=True)
class JobStatus:
    """Status of one job."""

    job: BatchJob
    key: str  # empty where the job cannot start
    cell_name: str
    state: str
    row: Mapping[str, Any]
    files: tuple[str, ...] = field(default=())

    @property
    def exit_code(self) -> int | None:
        return self.row.get("exit_code")

    @property
    def verdict(self) -> str:
        return str(self.row.get("verdict", "not run"))

    @property
    def report(self) -> str:
        """The job's report relative to the summary, empty where it has none."""
        return f"jobs/{self.job.label}/report.html" if "report.html" in self.files else ""

    @property
    def folder(self) -> str:
        """The job's folder relative to the summary, empty where it has none."""
        return f"jobs/{self.job.label}" if self.state != "waiting" and self.key else ""
