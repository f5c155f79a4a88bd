"""Episodes as a data set of LeRobot, in its format v3.0, which needs no LeRobot to write.

A row is an action, with what was seen before it. Depth is a TIFF of 32-bit numbers [m] and colours
are a PNG, so that no bit is lost; what has no place in the format, what was seen after the last
action, is left out.
"""

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

from mechsearch.evaluation.frames import Frames, recorded_camera
from mechsearch.types import Array

LEROBOT_VERSION = "v3.0"
"""Of the format."""

_CHUNK, _FILE_MB = 1000, 100
_PLACE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}

Column = tuple[dict[str, Any], Array]
"""A feature's description, and its values (T, ...)."""

Stats = dict[str, Array]


def write_lerobot(folder: Path, header: Mapping[str, Any], frames: Iterator[Frames]) -> None:
    """Fill a folder with a data set, which `LeRobotDataset(NAME, root=folder)` opens.

    Args:
        folder: An empty one.
        header: How the episodes came about.
        frames: The episodes, at least one.
    """
    physics = header["env"]["physics"]
    seconds = physics["action_steps"] * physics["time_step"]
    fps = max(1, round(1 / seconds))
    tasks: dict[str, int] = {}
    rows: list[dict[str, Any]] = []
    stats: list[dict[str, Stats]] = []
    features: dict[str, Any] = {}
    with _Files(folder / "data") as files:
        for number, shown in enumerate(frames):
            task = tasks.setdefault(shown.task, len(tasks))
            begun = rows[-1]["dataset_to_index"] if rows else 0
            length = len(shown.record.actions)
            columns = {
                **_columns(shown, _camera(header)),
                "timestamp": _numbers(np.arange(length, dtype=np.float32) / np.float32(fps)),
                "frame_index": _numbers(np.arange(length)),
                "episode_index": _numbers(np.full(length, number)),
                "index": _numbers(begun + np.arange(length)),
                "task_index": _numbers(np.full(length, task)),
            }
            features = {name: feature for name, (feature, _) in columns.items()}
            file = files.write(pa.table({name: _rows(*pair) for name, pair in columns.items()}))
            stats.append({name: _statistics(*pair) for name, pair in columns.items()})
            rows.append(_episode(number, shown, begun, file) | _flat(stats[-1]))
    episodes = folder / "meta" / "episodes" / _PLACE.format(chunk_index=0, file_index=0)
    episodes.parent.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(rows), episodes)
    pq.write_table(_tasks(tasks), folder / "meta" / "tasks.parquet")
    _write(folder / "meta" / "stats.json", _plain(_together(stats)))
    _write(folder / "meta" / "mechsearch.json", {**header, "seconds_per_action": seconds})
    about = {
        "codebase_version": LEROBOT_VERSION,
        "robot_type": "mechsearch",
        "total_episodes": len(rows),
        "total_frames": rows[-1]["dataset_to_index"],
        "total_tasks": len(tasks),
        "chunks_size": _CHUNK,
        "data_files_size_in_mb": _FILE_MB,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{len(rows)}"},
        "data_path": f"data/{_PLACE}",
        "video_path": None,
        "features": features,
    }
    _write(folder / "meta" / "info.json", about)


class _Files:
    """The files of the rows, of about a hundred megabytes each."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._number, self._size = folder, -1, 0
        self._writer: Any = None

    def __enter__(self) -> "_Files":
        return self

    def __exit__(self, *_: object) -> None:
        if self._writer:
            self._writer.close()

    def write(self, table: pa.Table) -> tuple[int, int]:
        """Append an episode's rows; return the numbers of the chunk and the file they are in."""
        if self._writer is None or self._size > _FILE_MB * 2**20:
            self.__exit__()
            self._number, self._size = self._number + 1, 0
            chunk, file = divmod(self._number, _CHUNK)
            path = self._folder / _PLACE.format(chunk_index=chunk, file_index=file)
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(path, table.schema)
        self._writer.write_table(table)
        self._size += table.nbytes
        return divmod(self._number, _CHUNK)


def _camera(header: Mapping[str, Any]) -> dict[str, Any]:
    return asdict(recorded_camera(header))


def _columns(shown: Frames, camera: Mapping[str, Any]) -> dict[str, Column]:
    """Return all of an episode but where it stands among the others."""
    record, seen = shown.record, {k: v[:-1] for k, v in shown.observations.items()}
    last = np.arange(len(record.actions)) == len(record.actions) - 1
    view = {"camera": dict(camera)}
    depth = {"is_depth_map": True, "depth_unit": "m"}
    image = seen.pop("position_image").astype(np.float32)
    mask = (image != 0).any(axis=1, keepdims=True)
    found = {
        "observation.images.rgb": _image(seen.pop("rgb"), view),
        "observation.images.depth": _image(seen.pop("depth").astype(np.float32), view | depth),
        "observation.images.target_mask": _image(np.uint8(255) * mask, view),
        "observation.position_image": _numbers(image),
        "observation.state": _numbers(seen.pop("ee_position"), ("x", "y", "z")),
    }
    if "grasp_depth" in seen:
        found["observation.images.grasp_depth"] = _image(seen.pop("grasp_depth")[:, None], depth)
        found["observation.images.segments"] = _image(seen.pop("segments")[:, None], {})
    found |= {f"observation.{key}": _numbers(values) for key, values in seen.items()}
    pose = ("x", "y", "z", "qw", "qx", "qy", "qz")
    names = ("kind", "gripper", *pose) if record.retrieval else ("x", "y", "z")
    terms = np.stack(list(record.reward_terms.values()), axis=1)
    return found | {
        "observation.occlusion": _numbers(record.occlusions[:-1]),
        "action": _numbers(record.actions, names),
        "next.reward": _numbers(record.rewards),
        "next.reward_terms": _numbers(terms, tuple(record.reward_terms)),
        "next.occlusion": _numbers(record.occlusions[1:]),
        "next.done": _numbers(last),
        "next.success": _numbers(last & shown.success),
    }


def _image(values: Array, info: Mapping[str, Any]) -> Column:
    """Return images (T, C, H, W) as a feature."""
    channels, height, width = values.shape[1:]
    names, shape = ["height", "width", "channels"], [height, width, channels]
    return {"dtype": "image", "shape": shape, "names": names, "info": dict(info)}, values


def _numbers(values: Array, names: Sequence[str] | None = None) -> Column:
    """Return numbers (T, ...) as a feature."""
    shape = list(values.shape[1:]) or [1]
    named = None if names is None else list(names)
    return {"dtype": str(values.dtype), "shape": shape, "names": named}, values


def _rows(feature: Mapping[str, Any], values: Array) -> pa.Array:
    if feature["dtype"] == "image":
        kind = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
        return pa.array([{"bytes": _encoded(image), "path": None} for image in values], kind)
    flat = pa.array(np.ascontiguousarray(values).ravel())
    if feature["shape"] == [1]:
        return flat
    if len(feature["shape"]) == 1:
        return pa.FixedSizeListArray.from_arrays(flat, feature["shape"][0])
    for size in reversed(feature["shape"]):
        flat = pa.ListArray.from_arrays(np.arange(0, len(flat) + 1, size, dtype=np.int32), flat)
    return flat


def _encoded(image: Array) -> bytes:
    """Return an image (C, H, W) as a file: TIFF for 32-bit numbers, else PNG."""
    whole = np.ascontiguousarray(image[0] if len(image) == 1 else image.transpose(1, 2, 0))
    file = io.BytesIO()
    Image.fromarray(whole).save(file, "TIFF" if whole.dtype == np.float32 else "PNG")
    return file.getvalue()


def _statistics(feature: Mapping[str, Any], values: Array) -> Stats:
    """Return what LeRobot normalises with: for each number, or each channel of an image."""
    x = values.astype(np.float64)
    of_images = x.ndim == 4
    if of_images:
        depth = feature.get("info", {}).get("is_depth_map") or feature["dtype"] != "image"
        x = (x if depth else x / 255).transpose(1, 0, 2, 3).reshape(x.shape[1], -1).T
    x = x.reshape(len(x), -1)
    found: dict[str, Array] = {
        "min": x.min(0), "max": x.max(0), "mean": x.mean(0), "std": x.std(0),
        **{name: np.quantile(x, share, 0) for name, share in _QUANTILES.items()},
    }  # fmt: skip
    shaped = {name: v.reshape(-1, 1, 1) if of_images else v for name, v in found.items()}
    return shaped | {"count": np.array([len(values)])}


def _together(stats: Sequence[Mapping[str, Stats]]) -> dict[str, Stats]:
    """Return the statistics of all episodes; quantiles are means of theirs, as LeRobot has them."""
    found = {}
    for name in stats[0]:
        own = [one[name] for one in stats]
        counts = np.concatenate([one["count"] for one in own])
        mean = _mean([one["mean"] for one in own], counts)
        square = _mean([one["std"] ** 2 + (one["mean"] - mean) ** 2 for one in own], counts)
        found[name] = {
            "min": np.min([one["min"] for one in own], axis=0),
            "max": np.max([one["max"] for one in own], axis=0),
            "mean": mean,
            "std": np.sqrt(square),
            **{q: _mean([one[q] for one in own], counts) for q in _QUANTILES},
            "count": counts.sum(keepdims=True),
        }
    return found


def _mean(values: Sequence[Array], counts: Array) -> Array:
    return np.asarray(np.average(np.stack(values), axis=0, weights=counts))


def _episode(number: int, shown: Frames, begun: int, file: tuple[int, int]) -> dict[str, Any]:
    record = shown.record
    return {
        "episode_index": number,
        "tasks": [shown.task],
        "length": len(record.actions),
        "dataset_from_index": begun,
        "dataset_to_index": begun + len(record.actions),
        "data/chunk_index": file[0],
        "data/file_index": file[1],
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
        "heap_seed": record.heap_seed,
        "policy": record.policy,
        "end": record.end,
        "success": shown.success,
        "objects": list(record.objects),
        "target": record.target,
    }


def _flat(stats: Mapping[str, Stats]) -> dict[str, Any]:
    return {
        f"stats/{name}/{kind}": value.tolist()
        for name, own in stats.items()
        for kind, value in own.items()
    }


def _plain(stats: Mapping[str, Stats]) -> dict[str, Any]:
    return {name: {kind: v.tolist() for kind, v in own.items()} for name, own in stats.items()}


def _tasks(tasks: Mapping[str, int]) -> pa.Table:
    """Return the tasks as pandas writes them, with their texts as the index."""
    columns = [
        {"name": "task_index", "field_name": "task_index", "pandas_type": "int64",
         "numpy_type": "int64", "metadata": None},
        {"name": "task", "field_name": "task", "pandas_type": "unicode",
         "numpy_type": "object", "metadata": None},
    ]  # fmt: skip
    about = {"index_columns": ["task"], "column_indexes": [], "columns": columns}
    table = pa.table({"task_index": pa.array(list(tasks.values()), pa.int64()), "task": [*tasks]})
    return table.replace_schema_metadata({"pandas": json.dumps(about)})


def _write(path: Path, content: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=2), encoding="utf-8")
