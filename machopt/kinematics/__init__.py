"""Physics and geometry, pure: (domain objects, joint positions) to numbers."""
