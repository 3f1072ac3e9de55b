"""Quantities of a workspace map under the forces of a job."""
