"""Score a policy of your own beside a teacher, on held-out heaps.

From the command line the same is `mechsearch evaluate my_module:make_policy --heaps ...`.
"""

import numpy as np

from mechsearch import make_env, make_policy
from mechsearch.evaluation.episodes import score
from mechsearch.evaluation.rollout import run


class TowardsTheTarget:
    """Goes to the mean position of the visible target pixels, and keeps pushing there."""

    keys = ("position_image",)

    def reset(self, rng):
        """Forget nothing: this policy has no memory."""

    def act(self, obs):
        """Return the direction to the visible target."""
        image = obs["position_image"].astype(float)
        visible = (image != 0).any(axis=0)
        if not visible.any():
            return np.zeros(3, np.float32)
        offset = image[:, visible].mean(axis=1)
        return (offset / max(np.linalg.norm(offset), 1e-6)).astype(np.float32)


env = make_env("single", split="held-out", privileged=True)
for name, policy in (
    ("mine", TowardsTheTarget()),
    ("spiral teacher", make_policy("teacher-spiral")),
):
    scores = score(run(policy, env, range(6)))
    reward, change = scores["reward"], scores["visibility_change"]
    print(f"{name}: reward {reward.mean:.1f} [{reward.ci_low:.1f}, {reward.ci_high:.1f}]", end=", ")
    print(f"occlusion reduced by {change.mean:.2f}")
