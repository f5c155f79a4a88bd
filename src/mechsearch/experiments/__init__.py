"""Work for many cores and many machines: the map over a Ray cluster, and runs by the list."""
