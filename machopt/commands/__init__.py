"""One command each, from files to files: load → call → write. The command line only parses and prints."""
