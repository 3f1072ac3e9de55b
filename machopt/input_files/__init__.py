"""Further input files: job lists, and the JSON schemas of all YAML inputs."""
