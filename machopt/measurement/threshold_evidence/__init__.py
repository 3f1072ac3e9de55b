"""Where each threshold's value comes from, and how sensitive results are to it."""
