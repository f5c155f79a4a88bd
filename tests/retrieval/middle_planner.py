"""A planner that needs no network: it grasps in the middle of what it sees, from above."""

import numpy as np

from mechsearch.grippers import RatedGrasps, gripper_named


class MiddlePlanner:
    """Two grasps that close along x, and one a little beside them, of any gripper that there is."""

    quality = (0.6, 0.5, 0.4)

    def __init__(self, name):
        self.gripper = gripper_named(name)

    def plan(self, view, rng, count=3):
        rng.random()
        rows, columns = np.nonzero(view.mask)
        if not len(rows):
            return RatedGrasps(np.empty((0, 7)), np.empty(0))
        top = np.median(view.depth[rows, columns])
        x, y, z = view.camera.points_at(columns.mean(), rows.mean(), top)
        down = (1.0, 0.0, 0.0, 0.0)
        poses = [(x, y, z - 0.01, *down), (x, y, z - 0.01, 0, 0, 0, 1), (x + 0.02, y, z, *down)]
        return RatedGrasps(np.array(poses), np.array(self.quality))


def segments_of(*boxes):
    """Return depth and segments of boxes: their segment, rows, columns and depth [m]."""
    depth = np.full((512, 512), 0.8, np.float32)
    segments = np.zeros((512, 512), np.uint8)
    for number, rows, columns, far in boxes:
        depth[slice(*rows), slice(*columns)] = far
        segments[slice(*rows), slice(*columns)] = number
    return {"grasp_depth": depth, "segments": segments}
