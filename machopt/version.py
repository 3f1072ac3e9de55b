"""The version, by itself, so that what writes it does not import the package's public face."""

__version__ = "0.1.0"
