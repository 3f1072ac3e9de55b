"""Syntax of G-code: blocks, words, decimals, headers."""
