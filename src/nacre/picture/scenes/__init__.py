"""Picture scenes and mesh files."""
