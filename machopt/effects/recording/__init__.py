"""Effects of a recording and not of the arm: sensor errors, delays, faults of columns."""
