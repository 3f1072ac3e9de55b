"""KUKA KRL: post and reader."""
