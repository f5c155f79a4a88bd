"""Start states: generate heaps, choose their targets, keep them in sets."""
