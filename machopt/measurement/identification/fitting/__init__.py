"""Least-squares fits of compliances to load tests."""
