"""Read and write stiffness.yaml: joint springs, terms, external joints."""
