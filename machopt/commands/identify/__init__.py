"""The command ``machopt identify``: load, compute, write."""
