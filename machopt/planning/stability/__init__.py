"""Stability of milling over configurations: ratio of the limit to the planned depth, and its price in the choice."""
