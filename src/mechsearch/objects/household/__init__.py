"""The built-in set: household objects made of primitives."""
