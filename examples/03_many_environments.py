"""Collect transitions from many environments in worker processes, all of them busy all the time."""

import numpy as np

from mechsearch import make_vector_env

ENVS, AT_ONCE, TRANSITIONS = 8, 2, 200


def main():
    """Push at random, and keep every transition that can be learnt from."""
    rng = np.random.default_rng(0)
    envs = make_vector_env(num_envs=ENVS, workers=2, condition="single")
    seen, _ = envs.reset(seed=0)
    actions = rng.uniform(-1, 1, (ENVS, 3)).astype(np.float32)
    envs.send(actions, range(ENVS))
    kept = []
    while len(kept) < TRANSITIONS:
        indices, (obs, rewards, terminated, truncated, info) = envs.receive(AT_ONCE)
        for k, env in enumerate(indices):
            over = terminated[k] or truncated[k]
            after = info["final_obs"][k]["depth"] if over else obs["depth"][k]
            failure = info["failure"][k] if "failure" in info else None
            if failure is None:
                kept.append((seen["depth"][env].copy(), actions[env].copy(), rewards[k], after))
            for key, rows in seen.items():
                rows[env] = obs[key][k]
        actions[indices] = rng.uniform(-1, 1, (AT_ONCE, 3))
        envs.send(actions[indices], indices)
    envs.close()
    mean = np.mean([reward for _, _, reward, _ in kept])
    print(f"{len(kept)} transitions, mean reward {mean:.2f}")


if __name__ == "__main__":  # Worker processes import this file.
    main()
