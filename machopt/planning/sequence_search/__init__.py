"""One configuration at each station, for the whole path at once.

In: the grid of candidates with its scores. Out: the sequence that costs least over it
(:class:`~machopt.planning.sequence_search.dynamic_programming.SequenceChoice`), exactly, the worst index included;
beside it what others would choose
(:mod:`~machopt.planning.baselines`).
"""
