"""A motion as robot programs: which posts are wanted, the moves of a program, its files written or withdrawn."""
