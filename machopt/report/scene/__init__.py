"""3-D scene of a page: joints, bodies, path."""
