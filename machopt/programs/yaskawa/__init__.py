"""Yaskawa INFORM (JBI): post and reader."""
