"""Training runs: configuration, the loops, and the run directory they write."""
