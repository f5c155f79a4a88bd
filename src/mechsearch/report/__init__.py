"""Tables, curves, pictures and films, remade from files alone."""
