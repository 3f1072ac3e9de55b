"""Generic CSV and JSON programs: joints in URDF convention, poses in the workpiece."""

from __future__ import annotations

from machopt.programs.writing.maker_rules import MakerRules

DIALECT = MakerRules(maker=False)
