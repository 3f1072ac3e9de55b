"""Recorded motions as uniform signals with derivatives."""
