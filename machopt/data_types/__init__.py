"""Frozen data types shared by the packages: cell, toolpath, stiffness, trajectory, options. SI units throughout."""
