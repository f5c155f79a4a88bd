"""`plus`: learning what pushes bring from how they look, and choosing among them (PyTorch)."""
