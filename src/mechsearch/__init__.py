"""Learn to uncover a target in a heap."""
