"""Model selection: which effects together explain the mismatch, and which of them are significant. Common to all
channels.
"""
