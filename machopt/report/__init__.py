"""The page a process engineer reads: figures, tables, verdict. Plotting lives here and nowhere else."""

from machopt.report.data import ReportData
from machopt.report.page import write_report

__all__ = ["ReportData", "write_report"]
