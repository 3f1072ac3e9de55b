"""What Sinumerik programs add to G-code: expressions, jumps and loops."""
