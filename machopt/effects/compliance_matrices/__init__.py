"""Compliance matrices of bodies: beams, tubes, symmetric 6 × 6 matrices."""
