"""Scores any policy on any heap set, without PyTorch."""
