"""Meshes of any origin: read, checked, decomposed and cached."""
