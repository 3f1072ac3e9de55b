"""Joint stiffness that varies over a grid of TCP positions."""
