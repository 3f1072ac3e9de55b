"""Reader of process.yaml: cutting conditions, coefficients and tolerances of the operations of a job."""

from machopt.cell.process_file.process_reader import load_process
from machopt.cell.process_file.process_schema import StockKeys

__all__ = ["StockKeys", "load_process"]
