"""Errors of a static recording that concern the data and not the robot. They are corrected and reported as findings."""
