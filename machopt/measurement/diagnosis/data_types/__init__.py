"""What a diagnosis speaks of: the problem, its readings and signals, what was asked, what is answered."""
