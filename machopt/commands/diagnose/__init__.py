"""The command ``machopt diagnose``: load, compute, write."""
