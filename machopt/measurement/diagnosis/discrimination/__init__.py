"""Experiment design that discriminates between competing explanations of a diagnosis.

diagnosis.json ─► open_hypotheses ─► predicted_signals (laws at poses × loads) ─► discrimination_plan
"""
