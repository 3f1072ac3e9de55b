"""Evaluation of a selected model: holdout validation, findings, detection limits."""
