"""Training runs: configuration, the loop, imitation, and the run directory they write."""
