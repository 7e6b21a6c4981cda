"""Materials: the one place where all families meet."""
