"""The 3-D picture of a page: joints, bodies, path."""
