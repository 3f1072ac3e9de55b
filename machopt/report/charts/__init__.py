"""Charts of the pages as plain data for the page scripts."""
