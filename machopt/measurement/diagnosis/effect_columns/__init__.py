"""Each law of the registry as a recording sees it: columns of the problem, at rest or in motion."""
