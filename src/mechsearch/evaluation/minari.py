"""Episodes as a data set of Minari: its on-disk format, in Parquet, which needs no Minari to write.

An episode of T actions has T + 1 observations, as there. Images are kept as they are, not as JPEG.
"""

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from mechsearch.evaluation.frames import Frames
from mechsearch.observe.observation import KINDS
from mechsearch.types import Array

MINARI_VERSION = "0.5.4"
"""Of Minari, whose format this is."""

_DECISION = 9


def write_minari(
    folder: Path, header: Mapping[str, Any], frames: Iterator[Frames], name: str
) -> None:
    """Fill a folder with a data set, which `minari.MinariDataset(folder / "data")` opens.

    Args:
        folder: An empty one.
        header: How the episodes came about.
        frames: The episodes, at least one.
        name: Of the data set, which makes its id.
    """
    data, steps, episodes, about = folder / "data", 0, 0, dict[str, str]()
    for number, shown in enumerate(frames):
        about = about or _spaces(shown)
        place = data / str(number)
        place.mkdir(parents=True)
        pq.write_table(_table(shown), place / "part-0.parquet", compression="zstd")
        _write(place / "metadata.json", _episode(number, shown))
        steps, episodes = steps + len(shown.record.actions), number + 1
    size = sum(file.stat().st_size for file in data.rglob("*.parquet"))
    about |= {"env_spec": spec} if (spec := _environment(header)) else {}
    _write(
        data / "metadata.json",
        {
            "dataset_id": dataset_id(name),
            "total_episodes": episodes,
            "total_steps": steps,
            "data_format": "parquet",
            "jpeg_encoding": False,
            "minari_version": MINARI_VERSION,
            "dataset_size": round(size / 1e6, 1),
            "algorithm_name": str(header["name"]),
            "requirements": [f"mechsearch>={header['version']}"],
            "mechsearch": dict(header),
            **about,
        },
    )


def dataset_id(name: str) -> str:
    """Return the id of a data set: its name, and a version where that has none."""
    plain = re.sub(r"[^\w-]+", "-", name).strip("-") or "mechsearch"
    return plain if re.search(r"-v\d+$", plain) else f"{plain}-v0"


def _write(path: Path, content: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(content), encoding="utf-8")


def _episode(number: int, shown: Frames) -> dict[str, Any]:
    record = shown.record
    return {
        "id": number,
        "total_steps": len(record.actions),
        "seed": record.heap_seed,
        "task": shown.task,
        "success": shown.success,
        "policy": record.policy,
        "end": record.end,
        "objects": list(record.objects),
        "target": record.target,
    }


def _table(shown: Frames) -> pa.Table:
    """Return an episode, a row for each observation; the last has no action."""
    record, length = shown.record, len(shown.record.actions)
    last = np.arange(length) == length - 1
    terms = {f"term_{name}": _padded(term, 0) for name, term in record.reward_terms.items()}
    infos = {**terms, "occlusion": record.occlusions, "success": _padded(last & shown.success, 0)}
    if record.retrieval:
        infos["outcome"] = np.array(["", *record.retrieval.outcomes])
    columns = {
        "observations": _struct({key: _rows(v) for key, v in shown.observations.items()}),
        "actions": _rows(_padded(record.actions, 1)),
        "rewards": pa.array(_padded(record.rewards, 1)),
        "terminations": pa.array(_padded(last & shown.terminated, 1)),
        "truncations": pa.array(_padded(last & (not shown.terminated), 1)),
        "infos": _struct({name: pa.array(values) for name, values in infos.items()}),
    }
    return pa.table(columns)


def _padded(values: Array, behind: int) -> Array:
    """Return rows (T, ...) with a row of zeros before them, or `behind` them."""
    nothing = np.zeros_like(values, shape=(1, *values.shape[1:]))
    return np.concatenate([values, nothing] if behind else [nothing, values])


def _struct(columns: Mapping[str, pa.Array]) -> pa.Array:
    return pa.StructArray.from_arrays(list(columns.values()), names=list(columns))


def _rows(values: Array) -> pa.Array:
    """Return an array (T, ...) as T lists of one length."""
    flat = np.ascontiguousarray(values).reshape(len(values), -1)
    kind = pa.list_(pa.from_numpy_dtype(flat.dtype), flat.shape[1])
    return pa.FixedSizeListArray.from_arrays(flat.ravel(), type=kind)


def _spaces(shown: Frames) -> dict[str, str]:
    """Return the spaces of observations and actions, as Minari writes them."""
    seen = {
        key: _box(values[0], KINDS[key].low, KINDS[key].high)
        for key, values in shown.observations.items()
    }
    most = np.inf if shown.record.retrieval else 1.0
    return {
        "observation_space": json.dumps({"type": "Dict", "subspaces": seen}),
        "action_space": json.dumps(_box(shown.record.actions[0], -most, most)),
    }


def _box(values: Array, low: float, high: float) -> dict[str, Any]:
    bounds = [np.full(values.shape, bound, values.dtype).tolist() for bound in (low, high)]
    kind, shape = str(values.dtype), list(values.shape)
    return {"type": "Box", "dtype": kind, "shape": shape, "low": bounds[0], "high": bounds[1]}


def _environment(header: Mapping[str, Any]) -> str:
    """Return what Gymnasium makes the task of again, on the embedded heaps."""
    retrieves = "grippers" in header["env"]
    name = "Retrieve" if retrieves else "SingleHeap"
    if header["condition"] == "dual":
        name = "RetrieveDual" if retrieves else "DualHeap"
    elif header["condition"] != "single":
        return ""
    from gymnasium import spec

    env = header["env"]
    plain = {k: env[k] for k in ("camera", "image_size", "sensor", "max_actions") if k in env}
    made = spec(f"mechsearch/{name}-v0")
    made.kwargs = {**made.kwargs, **plain}
    return str(made.to_json())
