"""Labelled grasps, the fit of grasp networks to them, and how far their ratings hold."""
