"""Many environments at once, in worker processes that may fail."""
