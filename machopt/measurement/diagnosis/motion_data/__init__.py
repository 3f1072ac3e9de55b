"""Recorded motions as uniformly sampled signals with derivatives."""
