"""Program tables in CSV and JSON: post and reader."""
