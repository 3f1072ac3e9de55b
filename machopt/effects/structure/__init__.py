"""Effects of the structure around the joints: base, links, tool, payload, heat."""
