"""URScript: post and reader."""
