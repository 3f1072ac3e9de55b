"""What readings can carry: their noise, what is held out of them, and which of them are gross errors."""
