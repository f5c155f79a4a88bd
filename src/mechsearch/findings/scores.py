"""How one policy did on the heaps of one condition: measured from its episodes, kept in small.

Episodes are megabytes, since every pose is recorded. What a report needs of them are a few numbers
for each heap; `compact` keeps these in a file beside the episodes, which stands for them where they
are absent.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mechsearch.evaluation.episodes import RETRIEVAL_METRICS, load_episodes, measure
from mechsearch.files import ARRAY_DAMAGE, SCORES_SUFFIX, read_arrays, write_whole
from mechsearch.findings.failure_modes import EPISODE_MODES, EpisodeMode, mode_of
from mechsearch.types import Array, Floats, MechSearchError

SCORES_FORMAT = 1
RANKS = ("worst", "median", "best")
_FACTS = ("name", "condition", "heap_set", "split", "trained", "training_actions", "seed")


@dataclass(frozen=True)
class ScoredPolicy:
    """One policy, trained once or not at all, on the heaps of one condition.

    Attributes:
        path: File of its episodes, which need not be there any more.
        digest: SHA-256 of that file.
        header: How the episodes came about.
        heaps: Seeds of the heaps (H,), ascending.
        counts: Objects in each heap (H,).
        values: Each metric on every heap (H,).
        modes: How the episode on every heap went (H).
    """

    path: Path
    digest: str
    header: Mapping[str, Any]
    heaps: NDArray[np.int64]
    counts: NDArray[np.int64]
    values: Mapping[str, Floats]
    modes: tuple[EpisodeMode, ...]

    def __post_init__(self) -> None:
        lacking = [fact for fact in _FACTS if fact not in self.header]
        if lacking:
            raise MechSearchError(f"{self.path} does not say its {', '.join(lacking)}")
        if (np.diff(self.heaps) <= 0).any():
            raise MechSearchError(f"{self.path} has more than one episode on a heap")
        lengths = {len(self.counts), len(self.modes), *map(len, self.values.values())}
        if lengths != {len(self.heaps)} or not len(self.heaps):
            raise MechSearchError(f"{self.path} does not have one score of each kind on every heap")

    @property
    def name(self) -> str:
        """Of the policy."""
        return str(self.header["name"])

    @property
    def trained(self) -> bool:
        """Whether it learnt."""
        return bool(self.header["trained"])

    @property
    def retrieves(self) -> bool:
        """Whether targets were to be retrieved, and not uncovered only."""
        return RETRIEVAL_METRICS[0] in self.values

    def learnt_in(self, run: str) -> bool:
        """Return whether it may have learnt in a run of that name; grippers follow the name."""
        return self.trained and (self.name == run or self.name.startswith(f"{run}-"))

    @property
    def actions(self) -> int:
        """Training actions."""
        return int(self.header["training_actions"])

    @property
    def seed(self) -> int:
        """Training seed, or evaluation seed where nothing was trained."""
        return int(self.header["training_seed" if self.trained else "seed"] or 0)


def read_scored(path: Path) -> ScoredPolicy:
    """Return a policy's scores: of its episodes if they are there, else of the compact file.

    Args:
        path: File of the episodes.

    Raises:
        MechSearchError: If neither is there, one is damaged, or the compact file is of other
            episodes than those beside it.
    """
    small = scores_file(path)
    if not path.exists() and small.exists():
        return load_scores(small)
    found = score_episodes(path)
    if small.exists() and load_scores(small).digest != found.digest:
        raise MechSearchError(
            f"{small} was measured from other episodes than {path} holds; remove it, or compact "
            "the episodes again"
        )
    return found


def score_episodes(path: Path) -> ScoredPolicy:
    """Return what is measured of recorded episodes; their poses are dropped."""
    evaluation = load_episodes(path)
    records = sorted(evaluation.episodes, key=lambda record: record.heap_seed)
    measured = [measure(record) for record in records]
    metrics = [name for name in measured[0] if all(name in values for values in measured)]
    return ScoredPolicy(
        path=path,
        digest=hashlib.sha256(path.read_bytes()).hexdigest(),
        header=evaluation.header,
        heaps=np.array([record.heap_seed for record in records], np.int64),
        counts=np.array([record.count for record in records], np.int64),
        values={name: np.array([values[name] for values in measured]) for name in metrics},
        modes=tuple(mode_of(record) for record in records),
    )


def compact(*sources: Path) -> list[Path]:
    """Write the compact scores of episodes beside them, and return where.

    Args:
        sources: Files of episodes, and folders of them.

    Raises:
        MechSearchError: If a file holds no episodes, or is damaged.
    """
    written = []
    for path in episode_files(sources):
        # Without its episodes a compact file is all that is left: it stays as it is.
        if path.exists() or not scores_file(path).exists():
            save_scores(scores_file(path), score_episodes(path))
            written.append(scores_file(path))
    return written


def scores_file(path: Path) -> Path:
    """Return where the compact scores of a file of episodes are kept."""
    return path.with_suffix(SCORES_SUFFIX)


def episode_files(sources: Iterable[Path]) -> list[Path]:
    """Return the files of episodes in folders and files, also where only compact scores are left.

    Raises:
        MechSearchError: If a source does not exist.
    """
    found: dict[Path, None] = {}
    for source in sources:
        if not (source.exists() or scores_file(source).exists()):
            raise MechSearchError(f"there is nothing at {source}")
        files = sorted(source.rglob("*.npz")) if source.is_dir() else [source]
        found |= {f.with_name(f.name.replace(SCORES_SUFFIX, ".npz")): None for f in files}
    return list(found)


def save_scores(path: Path, scored: ScoredPolicy) -> None:
    """Write the compact scores of a policy, whole or not at all; the same scores, the same bytes.

    Args:
        path: Ends in `SCORES_SUFFIX`.
        scored: What was measured.
    """
    text: dict[str, Any] = {"scores_format": SCORES_FORMAT, "digest": scored.digest}
    text |= {"header": dict(scored.header), "metrics": list(scored.values)}
    arrays: dict[str, Array] = {
        "text": np.frombuffer(json.dumps(text, sort_keys=True).encode(), np.uint8),
        "heaps": scored.heaps,
        "counts": scored.counts.astype(np.uint16),
        "values": np.array(list(scored.values.values())),
        "modes": np.array([EPISODE_MODES.index(one.mode) for one in scored.modes], np.uint8),
        "stretches": np.array([one.stretch for one in scored.modes], np.uint16),
    }
    write_whole(path, lambda partial: np.savez_compressed(partial, allow_pickle=False, **arrays))


def load_scores(path: Path) -> ScoredPolicy:
    """Read what `save_scores` wrote; nothing in the file is ever run.

    Raises:
        MechSearchError: If the file is missing, damaged, of a later version, or holds no scores.
    """
    arrays = read_arrays(path, "compact scores")
    try:
        text = json.loads(arrays["text"].tobytes())
        if text["scores_format"] != SCORES_FORMAT:
            raise MechSearchError(
                f"{path} has scores of format {text['scores_format']}; this version reads "
                f"{SCORES_FORMAT}"
            )
        ends = zip(arrays["modes"], arrays["stretches"], strict=True)
        return ScoredPolicy(
            path=path.with_name(path.name.replace(SCORES_SUFFIX, ".npz")),
            digest=text["digest"],
            header=text["header"],
            heaps=arrays["heaps"],
            counts=arrays["counts"].astype(np.int64),
            values=dict(zip(text["metrics"], arrays["values"], strict=True)),
            modes=tuple(EpisodeMode(EPISODE_MODES[mode], int(stretch)) for mode, stretch in ends),
        )
    except ARRAY_DAMAGE as error:
        raise MechSearchError(f"{path} is damaged or no compact scores: {error}") from None


def ranked_heaps(heaps: Iterable[int], rewards: Iterable[float]) -> dict[str, int]:
    """Return on which heap a policy did worst, middling and best by its rewards on them."""
    ranked = [heap for _, heap in sorted(zip(rewards, heaps, strict=True))]
    places = np.linspace(0, len(ranked) - 1, len(RANKS)).round().astype(int)
    return {name: int(ranked[place]) for name, place in zip(RANKS, places, strict=True)}
