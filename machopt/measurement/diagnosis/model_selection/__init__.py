"""Which effects together explain what is left, and what of that is proven: the same for every channel."""
