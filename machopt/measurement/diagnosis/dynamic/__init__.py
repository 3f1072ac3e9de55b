"""Channels of motions: joint torques, secondary encoders, a tracked TCP, and the checks of such a recording."""
