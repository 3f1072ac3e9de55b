"""Interfaces that the laws of effects implement, and the parameters they declare."""
