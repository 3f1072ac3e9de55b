"""The command ``machopt place``: load, compare places, write."""
