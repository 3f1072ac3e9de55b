"""Reader of process.yaml: cutting conditions, coefficients and tolerances of the operations of a job."""

from machopt.cell.process_file.process_reader import load_process

__all__ = ["load_process"]
