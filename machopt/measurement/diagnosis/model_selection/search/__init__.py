"""Search over sets of effects: forward selection, joint selection, shape refinement."""
