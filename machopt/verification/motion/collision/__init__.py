"""Contacts of the motion, by an independent collision library."""
