"""Planning options: schema, reading, conversion to SI."""
