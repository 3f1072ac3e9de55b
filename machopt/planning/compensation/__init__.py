"""The commanded path shifted against the predicted deflection.

In: a plan. Out: the plan with its shift, the margins that driving it takes, and how much of the deflection is removed
and how sure that is.
"""
