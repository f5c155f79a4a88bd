"""Hand-made episodes."""

from collections.abc import Callable

import numpy as np
import pytest

from mechsearch.evaluation.episodes import EpisodeRecord

MakeEpisode = Callable[..., EpisodeRecord]


@pytest.fixture
def make_episode() -> MakeEpisode:
    """Return a maker of episodes whose numbers follow from the seed alone."""

    def make(heap_seed: int = 0, length: int = 4, **changes: object) -> EpisodeRecord:
        rng = np.random.default_rng(heap_seed)
        n = int(changes.get("count", 5))
        values: dict[str, object] = {
            "heap_seed": heap_seed,
            "count": n,
            "condition": "single",
            "policy": "random",
            "objects": tuple(f"thing-{i}" for i in range(n)),
            "target": n - 1,
            "actions": rng.uniform(-1, 1, (length, 3)).astype(np.float32),
            "ee_positions": rng.normal(size=(length + 1, 3)),
            "occlusions": rng.uniform(size=length + 1),
            "poses": rng.normal(size=(length + 1, n, 7)),
            "reward_terms": {
                "visibility": rng.normal(size=length),
                "idleness": np.full(length, -0.5),
            },
            "clutter_moved": rng.uniform(0, 0.01, length),
            "target_moved": rng.uniform(0, 0.01, length),
            "end": "action limit",
            "action_limit": 50,
        }
        return EpisodeRecord(**(values | changes))

    return make
