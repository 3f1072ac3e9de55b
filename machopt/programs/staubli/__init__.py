"""Stäubli VAL 3: post and reader."""
