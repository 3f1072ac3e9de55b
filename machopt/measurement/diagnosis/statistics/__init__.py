"""Statistics of readings: noise, cross-validation, outliers."""
