"""Generic CSV and JSON: joints as the URDF counts them, poses in the workpiece."""

from __future__ import annotations

from machopt.formats.posts.dialect import Dialect

DIALECT = Dialect(maker=False)
