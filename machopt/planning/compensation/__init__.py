"""Compensation of the predicted deflection by a shift of the commanded path.

In: a plan. Out: the plan with its shift, the margins that the driven motion uses, and the share of the deflection that
is removed with its confidence interval.
"""
