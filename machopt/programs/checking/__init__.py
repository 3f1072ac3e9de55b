"""Words of a program that are recomputed from its motion, to check them; used by the verification alone."""
