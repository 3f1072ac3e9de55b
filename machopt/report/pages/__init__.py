"""The self-contained HTML pages of each command."""
