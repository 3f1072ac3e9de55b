"""The command ``machopt plan-poses``: load, design the measurement, write."""
