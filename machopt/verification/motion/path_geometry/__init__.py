"""The programmed path as the verification sees it: axis, reference, polyline."""
