"""Generic CSV and JSON: joints as the URDF counts them, poses in the workpiece."""

from __future__ import annotations

from machopt.programs.writing.maker_rules import MakerRules

DIALECT = MakerRules(maker=False)
