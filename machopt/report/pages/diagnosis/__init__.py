"""The page of ``machopt diagnose``."""
