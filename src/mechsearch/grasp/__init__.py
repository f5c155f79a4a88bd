"""Graspability: grasp quality networks, their scores, and grasps that are put to the test."""
