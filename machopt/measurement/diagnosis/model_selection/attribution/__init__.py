"""Checks that prevent an effect from being reported for a mismatch that another one causes."""
