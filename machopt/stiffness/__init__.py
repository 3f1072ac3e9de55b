"""Joint springs and further elastic terms, and the compliance of the TCP."""
