"""Channels of an arm in motion: torques, encoders behind the gears, a tracked TCP, and the checks of such a record."""
