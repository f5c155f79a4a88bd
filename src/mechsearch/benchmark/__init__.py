"""Fixed tasks and heaps, and submissions: recorded episodes that are played again."""
