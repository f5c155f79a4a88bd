"""Long tests: many actions, processes killed, rules broken on purpose. `make soak` runs them."""
