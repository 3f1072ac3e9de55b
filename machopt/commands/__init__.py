"""Commands, each from files to files: load, compute, write. The command line only parses and prints."""
