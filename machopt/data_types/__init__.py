"""Frozen nouns that cross a boundary: cell, toolpath, stiffness, trajectory, options. SI units throughout."""
