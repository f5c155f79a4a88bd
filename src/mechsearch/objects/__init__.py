"""What can lie in a heap: object sets, prepared for physics and rendering."""
