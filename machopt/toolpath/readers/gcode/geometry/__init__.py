"""Geometry of G-code blocks: arcs, contours, planes, patterns."""
