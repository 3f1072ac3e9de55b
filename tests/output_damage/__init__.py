"""Damaged output folders of a plan: tables of damages, one module per part of the folder;
``tests/test_output_damage_detection.py`` applies every row.

A row states what is changed in the folder, by how much, and which check detects it. Each damage is applied twice:
unchanged (the hashes of the manifest detect it) and *resealed* (the hashes are updated, so that only the content can
show the damage).
"""
