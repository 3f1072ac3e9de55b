"""HTML report pages: figures, tables, verdict. All plotting is in this package."""

from machopt.report.page_types.optimize_page_data import ReportData
from machopt.report.pages.optimize.optimize_page import write_report

__all__ = ["ReportData", "write_report"]
