"""``machopt view``: a plan in a browser on this machine, steered and planned again."""
