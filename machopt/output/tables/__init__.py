"""CSV and Parquet tables of an output folder."""
