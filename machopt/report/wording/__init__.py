"""Wording of the pages: units, effects, verdicts."""
