"""The page a process engineer reads: figures, tables, verdict. Plotting lives here and nowhere else."""

from machopt.report.page_types.optimize_report import ReportData
from machopt.report.pages.optimize.optimize_page import write_report

__all__ = ["ReportData", "write_report"]
