"""The YCB objects from their official site."""
