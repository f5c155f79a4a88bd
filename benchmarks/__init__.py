"""How fast everything is, beside named peers; `make bench` runs it."""
