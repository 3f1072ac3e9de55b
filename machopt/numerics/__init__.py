"""Array types, rigid transforms, compiled functions, worker threads."""
