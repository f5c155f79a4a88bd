"""Long tests: many actions, and processes killed again and again. `make soak` runs them."""
