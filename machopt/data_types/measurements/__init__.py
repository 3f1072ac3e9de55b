"""Data types of measurements: recordings, pose tables, measured stiffness."""
