"""ABB RAPID: post and reader."""
