"""FANUC LS: post and reader."""
