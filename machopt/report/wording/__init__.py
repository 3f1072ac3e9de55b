"""Words of the pages: units, effects, verdicts."""
