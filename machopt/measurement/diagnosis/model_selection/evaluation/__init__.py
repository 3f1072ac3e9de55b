"""What a selected model is worth: held-out validation, findings, detection limits."""
