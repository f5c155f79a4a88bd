"""Pushes: their shapes, the route that carries one out, and how one looks to a camera."""
