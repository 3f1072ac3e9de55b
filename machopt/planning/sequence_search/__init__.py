"""Search for one configuration at each station, for the whole path at once.

In: the grid of candidates with its scores. Out: the cheapest sequence over it
(:class:`~machopt.planning.sequence_search.dynamic_programming.SequenceChoice`), exact with the worst index included.
:mod:`~machopt.planning.baselines` computes sequences without a search.
"""
