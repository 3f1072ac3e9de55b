"""``machopt process``: cutting coefficients from measured cuts."""
