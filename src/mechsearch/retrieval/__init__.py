"""Getting the target into the gripper: what grasps on it are worth, and whether they lift it."""
