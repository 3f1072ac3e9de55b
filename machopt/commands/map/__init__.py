"""The command ``machopt map``: load, compute, write."""
