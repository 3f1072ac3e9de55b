"""Data of each page, collected from results: numbers in SI and words, no markup."""
