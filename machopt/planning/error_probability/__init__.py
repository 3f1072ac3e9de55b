"""Uncertainty of a predicted error: stiffness, loads and position as common draws, and the price of a tolerance.

In: stiffness file, process, loads of the points. Out: the probability that a configuration meets the tolerance of its
point, as a price for the choice (``objective: tolerance``), and the draws that the predicted errors are made of.
"""
