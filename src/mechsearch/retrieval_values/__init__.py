"""Learning what pushes and removals make of the chance to grasp the target: `retrieve`."""
