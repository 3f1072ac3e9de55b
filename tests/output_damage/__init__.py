"""Damages of a finished plan: tables of rows, one module per part; ``tests/test_output_damage_detection.py`` applies
every row.

A row says what is done to the folder, by how much, and which check catches it. Each is applied twice: as it is (the
manifest's hashes catch it) and *resealed* (the manifest is made to fit again, so that only the content can tell).
"""
