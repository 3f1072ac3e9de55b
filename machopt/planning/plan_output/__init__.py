"""A plan in rows and words.

In: a plan with its motion. Out: a row a point, why a point cannot be reached and what would help, the map of contacts,
and what result.json tells.
"""
