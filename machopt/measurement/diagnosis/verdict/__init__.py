"""Summary of a diagnosis: verdict sentence, sufficiency of the data, deviating springs of the cell."""
