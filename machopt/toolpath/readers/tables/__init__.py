"""Point tables: CSV, Parquet and pose lists."""
