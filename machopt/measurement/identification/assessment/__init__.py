"""How well the identified stiffness is known: covariance, identifiability, held-out error."""
