"""The command ``machopt optimize``: load, compute, write, verify."""
