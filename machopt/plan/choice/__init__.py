"""One configuration at each station, for the whole path at once.

In: the grid of candidates with its scores. Out: the sequence that costs least over it
(:class:`~machopt.plan.choice.choose.Choice`), exactly, the worst index included; beside it what others would choose
(:mod:`~machopt.plan.choice.baseline`).
"""
