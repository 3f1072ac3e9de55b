"""Toy controller of the tests: a maker's folder as ``machopt/programs`` holds them."""
