"""What the readers of all makers share."""
