"""Which hypotheses are worth a fit: significance, transfer between sessions."""
