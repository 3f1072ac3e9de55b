"""Screening of hypotheses: significance and transfer between sessions."""
