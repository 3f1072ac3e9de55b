"""A robot with physics that a compliance model leaves out; shares no code and no law with the package it tests."""
