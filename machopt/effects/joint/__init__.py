"""Effects of a single joint and its drive."""
