"""External joints over a grid: what was asked of them, and which of their values are good.

In: a setup, a path, what the user asked. Out: groups of operations that share where the joints stand, values for each
group and curves for joints that move along, in the order in which they look good at some stations. Nothing is planned
in full here.
"""
