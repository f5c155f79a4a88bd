"""Opens a data set with Minari itself, in an environment of its own: FOLDER EXPECTED."""

import os
import sys
from pathlib import Path

import numpy as np

folder, expected = Path(sys.argv[1]), np.load(sys.argv[2])
os.environ["MINARI_DATASETS_PATH"] = str(folder.parent)

import minari  # noqa: E402

data = minari.load_dataset(folder.name)
assert data.spec.dataset_id == folder.name
count = 0
for number, episode in enumerate(data):
    found = {
        **{f"observations/{key}": values for key, values in episode.observations.items()},
        **{f"infos/{key}": values for key, values in episode.infos.items()},
        "actions": episode.actions,
        "rewards": episode.rewards,
        "terminations": episode.terminations,
        "truncations": episode.truncations,
    }
    for name, values in found.items():
        np.testing.assert_array_equal(values, expected[f"{number}/{name}"], err_msg=name)
        assert values.dtype == expected[f"{number}/{name}"].dtype, name
        count += 1
    first = {key: values[0] for key, values in episode.observations.items()}
    assert data.observation_space.contains(first)
    assert data.action_space.contains(episode.actions[0])
assert count == len(expected.files), set(expected.files)
facts = list(data.storage.get_episode_metadata(range(data.total_episodes)))
assert all(one["task"].split()[0] in ("uncover", "retrieve") for one in facts)
print(f"Minari: {data.total_episodes} episodes, {data.total_steps} steps, all as they were")
