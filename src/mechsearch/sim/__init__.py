"""Physics: the world, its workspace, the pusher, and settling."""
