"""Toy statements that cannot move points or frames, with the reason."""

from __future__ import annotations

TOY = {"BEEP": "a sound", "STOP": "the end of the program"}
