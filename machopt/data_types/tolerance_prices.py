"""Prices of the tolerance objective, which search and terminal share."""

FAILED_POINT_PRICE = 1e4  # of a point whose probability is below the quantile: more than any shortfall and any J
SHORTFALL_PRICE = 5e3  # of a mean shortfall of 1: 1e-3 of it is more than J usually differs
