"""Filmstrips, films, sheets of heaps and objects, and grasps, from recorded states."""
