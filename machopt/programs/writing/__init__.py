"""What the posts of all makers share: template language, target insertion, blend zones."""
