"""Assessment of an identification: covariance, identifiability, cross-validated errors."""
