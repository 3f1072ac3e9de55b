"""Collision bodies, distances, swept motion and gouge depth."""
