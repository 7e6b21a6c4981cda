"""How recipes are written and checked."""
