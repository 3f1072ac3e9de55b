"""Toy controller: the folder of a maker as in ``machopt/programs``."""
