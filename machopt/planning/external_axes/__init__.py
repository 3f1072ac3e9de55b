"""External joints: user requests, grids of values and curves along the path.

In: a setup, a path, the user's options. Out: groups of operations that share the positions of the joints, values for
each group, and curves for joints that move along the path, ordered by their estimate at some stations. No plan is
computed in full here.
"""
