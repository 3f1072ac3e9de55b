"""Static SVG pictures."""
