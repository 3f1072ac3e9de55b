"""An output folder held against everything it follows from: what the robot loads and what is told are read back."""
