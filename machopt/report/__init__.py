"""HTML report pages: figures, tables, verdict. All plotting is in this package."""
