"""The main job from files to files: load → plan → export → verify → report. The command line only parses and prints."""
