"""Opens a data set with LeRobot itself, in an environment of its own: FOLDER EXPECTED."""

import sys

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from torch.utils.data import DataLoader

folder, expected = sys.argv[1], dict(np.load(sys.argv[2]))
data = LeRobotDataset("local/heaps", root=folder, depth_output_unit="m")
tasks = expected.pop("task").tolist()
assert data.num_frames == len(data) == len(tasks)
rows = [data[i] for i in range(len(data))]
assert [row["task"] for row in rows] == tasks
for name, values in expected.items():
    found = np.stack([row[name].numpy() for row in rows])
    if values.dtype == np.uint8:
        found = np.round(found * 255)
    assert found.reshape(values.shape).shape == values.shape, (name, found.shape)
    single = values.astype(np.float32) if values.dtype == np.float64 else values
    np.testing.assert_array_equal(found.reshape(values.shape), single, err_msg=name)
left = set(rows[0]) - set(expected) - {"task"}
assert not left, left
assert set(data.meta.stats) == set(data.meta.features)
last = [episode["dataset_to_index"] - 1 for episode in data.meta.episodes]
assert [i for i, row in enumerate(rows) if row["next.done"]] == last
chosen = data.meta.filter_episodes(lambda episode: episode["episode_index"] > 0)
ahead = LeRobotDataset(
    "local/heaps", root=folder, episodes=chosen, delta_timestamps={"action": [0, 1 / data.fps]}
)
batch = next(iter(DataLoader(ahead, batch_size=2)))
assert batch["action"].shape[:2] == (2, 2)
print(f"LeRobot: {data.num_episodes} episodes, {data.num_frames} frames, all as they were")
