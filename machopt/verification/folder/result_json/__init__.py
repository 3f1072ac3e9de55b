"""The values of result.json, computed a second time."""
