"""Columns of each registered law in the coordinates of a channel, for static recordings and motions."""
