"""Still SVG pictures."""
