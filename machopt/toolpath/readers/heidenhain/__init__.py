"""Heidenhain: conversational programs and DIN/ISO."""
