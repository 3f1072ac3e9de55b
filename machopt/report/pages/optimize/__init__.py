"""The page of ``machopt optimize``."""
