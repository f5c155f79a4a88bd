"""Recorded episodes: what happened, the file that keeps them, their scores, and the table of all.

The heap is the unit of sampling: every episode counts once, lost targets and failed simulations
included. Means have Student's t intervals; shares of episodes have a Wilson score interval, which
stays inside [0, 1] and does not shrink to a point when all episodes end alike.
"""

import csv
import io
import json
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, fields
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from mechsearch.files import ARRAY_DAMAGE, locked, read_arrays, write_text, write_whole
from mechsearch.types import (
    CALLED_UNCOVERED,
    DECISION_NAMES,
    DECISION_SIZE,
    GRASP,
    PUSH,
    REMOVE,
    USED_UP,
    Array,
    Floats,
    MechSearchError,
)

EPISODE_FORMAT = 1
RETRIEVAL_FORMAT = 2
"""Of files whose episodes are of retrieval, which earlier versions cannot read."""

UNCOVERED, STOPPED = "uncovered", "stopped"
"""Ends of an episode: the simulator says that the target is uncovered; what looks at images does.
"""

_STATES = ("ee_positions", "occlusions", "poses")
_STEPS = ("actions", "clutter_moved", "target_moved")
_FACTS = ("heap_seed", "count", "condition", "policy", "target", "end", "action_limit")

METRICS = (
    *("reward", "visibility_change", "uncovered_rate"),
    *("episode_actions", "clutter_moved_m", "target_moved_m"),
)
"""The scores of an evaluation; each reward term follows them as `term_<name>`."""

GRASP_METRICS = ("graspability_change", "retrieval_before", "retrieval_after")
"""Scores of episodes whose target a grasp network has rated and a gripper has tried to lift."""

ATTEMPTS = {"retrieved_within_1": 1, "retrieved_within_3": 3, "retrieved_within_5": 5}
"""Scores that say whether the target was in the hand after so many attempts."""

RETRIEVAL_METRICS = (
    *(*ATTEMPTS, "grasp_attempts", "push_actions", "removals"),
    *("clutter_moved_m", "wrong_objects"),
)
"""The scores of an evaluation of retrieval, in place of `METRICS`."""

CEILING_METRICS = (*ATTEMPTS, "retrievable")
"""Scores of targets whose grasps are tried once all clutter is gone: after so many of the best
ones, and whether any grasp at all retrieves it."""

SHARES = ("uncovered_rate", "retrieval_before", "retrieval_after", *CEILING_METRICS)
"""Scores that are 1 or 0 in one episode."""

_LOWER_IS_BETTER = (
    *("episode_actions", "clutter_moved_m", "target_moved_m"),
    *("grasp_attempts", "push_actions", "removals", "wrong_objects"),
)
HIGHER_IS_BETTER = {
    name: name not in _LOWER_IS_BETTER
    for name in (*METRICS, *GRASP_METRICS, *RETRIEVAL_METRICS, *CEILING_METRICS)
}

IN_HAND = "retrieved"
"""End of an episode whose target was retrieved."""

RETRIEVED = "success"
CONFIDENCE = 0.95


@dataclass(frozen=True)
class GraspRecord:
    """What a gripper could do with the target before and after an episode.

    Attributes:
        before: Graspability at the beginning, in [0, 1].
        after: At the end, at rest and the robot out of the way; 0 if the target is lost.
        alone: At the beginning, all clutter removed.
        lift_before: What the best grasp came to at the beginning: "success" or a failure's name;
            empty where there was no grasp to try.
        lift_after: Likewise at the end.
    """

    before: float
    after: float
    alone: float
    lift_before: str
    lift_after: str


@dataclass(frozen=True)
class RetrievalRecord:
    """What came of the decisions of an episode of retrieval.

    Attributes:
        outcomes: Of each decision (T,): see `RetrieveEnv`.
        held: Indices of the objects that came up in each (T,).
    """

    outcomes: tuple[str, ...]
    held: tuple[tuple[int, ...], ...]


@dataclass(frozen=True)
class EpisodeRecord:
    """One episode of T actions among N objects.

    Attributes:
        heap_seed: Seed of the heap, which names it in its set.
        count: Objects in each heap: N for "single", N / 2 for "dual".
        condition: Such as "single" or "dual".
        policy: Who acted.
        objects: Names of the N objects.
        target: Index of the target among them.
        actions: Commands (T, 3) in [-1, 1], workspace axes; in retrieval decisions (T, 9) float64.
        ee_positions: End effector (T + 1, 3) [m], the start first.
        occlusions: Share of the target's projection that is hidden (T + 1,), in [0, 1].
        poses: Object poses (T + 1, N, 7): position [m], unit quaternion (w, x, y, z).
        reward_terms: Each named reward term (T,).
        clutter_moved: Mean displacement of the other objects in each action (T,) [m].
        target_moved: Displacement of the target in each action (T,) [m].
        end: "uncovered" or "stopped", "action limit", "lost" or "failure: reason"; in retrieval
            "retrieved" or "budget" in place of the first three. It is empty while the episode goes
            on.
        action_limit: Number of actions after which the episode would have been cut; in retrieval of
            pushes, at most.
        grasp: What a gripper could do with the target; None where it was not measured.
        retrieval: What came of the decisions of retrieval; None where the target is uncovered only.
    """

    heap_seed: int
    count: int
    condition: str
    policy: str
    objects: tuple[str, ...]
    target: int
    actions: NDArray[np.float32] | Floats
    ee_positions: Floats
    occlusions: Floats
    poses: Floats
    reward_terms: Mapping[str, Floats]
    clutter_moved: Floats
    target_moved: Floats
    end: str
    action_limit: int
    grasp: GraspRecord | None = None
    retrieval: RetrievalRecord | None = None

    def __post_init__(self) -> None:
        t, n = len(self.actions), len(self.objects)
        expected: dict[str, tuple[int, ...]] = {
            "actions": (t, DECISION_SIZE if self.retrieval else 3),
            "ee_positions": (t + 1, 3), "occlusions": (t + 1,),
            "poses": (t + 1, n, 7), "clutter_moved": (t,), "target_moved": (t,),
        }  # fmt: skip
        shapes = {name: np.shape(getattr(self, name)) for name in expected}
        shapes |= {name: np.shape(term) for name, term in self.reward_terms.items()}
        expected |= dict.fromkeys(self.reward_terms, (t,))
        if self.retrieval:
            shapes |= {name: (len(values),) for name, values in vars(self.retrieval).items()}
            expected |= {"outcomes": (t,), "held": (t,)}
        for name, shape in shapes.items():
            if shape != expected[name]:
                raise MechSearchError(
                    f"{name} of the episode on heap {self.heap_seed} is {shape}; "
                    f"expected {expected[name]} for {t} actions and {n} objects"
                )
        if not 0 <= self.target < n:
            raise MechSearchError(f"target {self.target} is not one of {n} objects")

    @property
    def uncovered(self) -> bool:
        """Whether the episode ended because the target was completely visible, or nearly so."""
        right = self.end == STOPPED and self.occlusions[-1] <= CALLED_UNCOVERED
        return self.end == UNCOVERED or bool(right)

    @property
    def removed(self) -> tuple[int, ...]:
        """Indices of the objects in the tray, the first one first; the target if it was retrieved.

        Nothing is removed where the target is uncovered only.
        """
        if self.retrieval is None:
            return ()
        kinds = self.actions[:, 0].tolist()
        return tuple(
            index
            for kind, held in zip(kinds, self.retrieval.held, strict=True)
            if held == (self.target,) or (kind == REMOVE and self.target not in held)
            for index in held
        )

    @property
    def rewards(self) -> Floats:
        """The reward of each action (T,), the sum of its terms."""
        return sum(self.reward_terms.values(), np.zeros(len(self.actions)))


@dataclass(frozen=True)
class Evaluation:
    """One policy on a set of heaps.

    Attributes:
        header: How the episodes came about: JSON values under text keys.
        episodes: In the order of the heaps.
    """

    header: Mapping[str, Any]
    episodes: tuple[EpisodeRecord, ...]


def save_episodes(path: str | Path, evaluation: Evaluation) -> None:
    """Write an evaluation as one `.npz`, whole or not at all.

    The same episodes give the same bytes.

    Raises:
        MechSearchError: If there is no episode, or their reward terms differ.
    """
    episodes = evaluation.episodes
    if not episodes:
        raise MechSearchError("there is no episode to save; expected at least one")
    terms = tuple(episodes[0].reward_terms)
    if any(tuple(episode.reward_terms) != terms for episode in episodes):
        raise MechSearchError("the episodes have different reward terms; expected the same in all")
    of_retrieval = {episode.retrieval is not None for episode in episodes}
    if len(of_retrieval) > 1:
        raise MechSearchError("some of the episodes are of retrieval; expected all or none")
    text = {
        "format": RETRIEVAL_FORMAT if of_retrieval == {True} else EPISODE_FORMAT,
        "header": dict(evaluation.header),
        "terms": terms,
        "episodes": [_description(episode) for episode in episodes],
    }
    arrays: dict[str, Array] = {"text": np.array(json.dumps(text, sort_keys=True))}
    for name in _STATES + _STEPS:
        arrays[name] = _joined(getattr(episode, name) for episode in episodes)
    for term in terms:
        arrays[f"term_{term}"] = _joined(episode.reward_terms[term] for episode in episodes)

    def write(partial: Path) -> None:
        with partial.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)

    write_whole(Path(path), write)


class _Header(dict[str, Any]):
    """A header from a file, which says in words what it lacks."""

    def __missing__(self, key: str) -> Any:
        raise MechSearchError(
            f"the evaluation {self.get('name', '')!r} does not say its {key.replace('_', ' ')}: "
            "its file is damaged, or of another version"
        )


_EXPECTED = "expected a file that `mechsearch evaluate` or `view` wrote (.npz)"


def load_episodes(path: str | Path) -> Evaluation:
    """Read what `save_episodes` wrote; nothing in the file is ever run.

    Raises:
        MechSearchError: If the file is missing, damaged, or not an evaluation.
    """
    path = Path(path)
    if path.is_dir():
        raise MechSearchError(f"{path} is a folder; expected an evaluation (.npz)")
    try:
        arrays = read_arrays(path, "evaluation")
    except MechSearchError as error:
        raise MechSearchError(f"{error}; {_EXPECTED}") from None
    try:
        text = json.loads(str(arrays["text"]))
        if text["format"] not in (EPISODE_FORMAT, RETRIEVAL_FORMAT):
            raise MechSearchError(
                f"{path} has episode format {text['format']}; this version reads {EPISODE_FORMAT} "
                f"and {RETRIEVAL_FORMAT}"
            )
        return Evaluation(_Header(text["header"]), tuple(_split(arrays, text)))
    except ARRAY_DAMAGE as error:
        raise MechSearchError(f"{path} is damaged or no evaluation: {error}; {_EXPECTED}") from None


def _description(episode: EpisodeRecord) -> dict[str, Any]:
    values = {name: getattr(episode, name) for name in _FACTS}
    if episode.grasp is not None:
        values["grasp"] = asdict(episode.grasp)
    if episode.retrieval is not None:
        values["retrieval"] = asdict(episode.retrieval)
    return values | {"objects": list(episode.objects), "length": len(episode.actions)}


def _joined(parts: Iterable[Array]) -> Array:
    rows = list(parts)
    width = rows[0].shape[-1:] if rows[0].ndim > 1 else ()
    return np.concatenate([row.reshape(-1, *width) for row in rows])


def _split(arrays: Mapping[str, Array], text: Mapping[str, Any]) -> Iterable[EpisodeRecord]:
    """Yield the episodes that `_joined` laid end to end."""
    descriptions: Sequence[dict[str, Any]] = text["episodes"]
    lengths = np.array([episode["length"] for episode in descriptions])
    sizes = {name: lengths + 1 for name in _STATES}
    sizes["poses"] = (lengths + 1) * [len(episode["objects"]) for episode in descriptions]
    pieces = {
        name: np.split(rows, np.cumsum(sizes.get(name, lengths))[:-1])
        for name, rows in arrays.items()
        if name != "text"
    }
    for i, description in enumerate(descriptions):
        objects = tuple(description["objects"])
        own: dict[str, Any] = {name: pieces[name][i] for name in _STATES + _STEPS}
        own["poses"] = own["poses"].reshape(description["length"] + 1, len(objects), 7)
        yield EpisodeRecord(
            **{name: description[name] for name in _FACTS},
            **own,
            objects=objects,
            reward_terms={term: pieces[f"term_{term}"][i] for term in text["terms"]},
            grasp=GraspRecord(**description["grasp"]) if "grasp" in description else None,
            retrieval=_retrieval(description["retrieval"]) if "retrieval" in description else None,
        )


def _retrieval(told: Mapping[str, Any]) -> RetrievalRecord:
    return RetrievalRecord(tuple(told["outcomes"]), tuple(map(tuple, told["held"])))


@dataclass(frozen=True)
class Estimate:
    """A mean over heaps and its confidence interval; the interval is NaN for a single heap."""

    mean: float
    ci_low: float
    ci_high: float
    heaps: int


def measure(record: EpisodeRecord) -> dict[str, float]:
    """Return the metrics of one episode.

    Returns:
        `reward` (sum over the episode), `visibility_change` (start minus end occlusion),
        `uncovered_rate` (1 or 0), `episode_actions` (the limit unless uncovered),
        `clutter_moved_m` (path length of a non-target object, averaged over them) [m],
        `target_moved_m` (path length of the target) [m], `term_<name>` for each reward term, and
        where it was measured `graspability_change` (end minus start) and `retrieval_before` and
        `retrieval_after` (1 if the best grasp lifts the target, else 0).
        In retrieval `reward`, `RETRIEVAL_METRICS` and the terms: `retrieved_within_<k>` (1 if the
        target was in the hand after at most k attempts, else 0), `grasp_attempts` (grasps of the
        target, and a removal that brought it up), `push_actions`, `removals` (other attempts at a
        removal), `clutter_moved_m`, and `wrong_objects` (grasps that brought up others alone).

    Raises:
        MechSearchError: If a value is not finite, since it could not stay in a mean.
    """
    values = {"reward": record.rewards.sum()}
    values |= _retrieving(record) if record.retrieval else _uncovering(record)
    values |= {f"term_{name}": term.sum() for name, term in record.reward_terms.items()}
    grasp = record.grasp
    if grasp is not None:
        values["graspability_change"] = grasp.after - grasp.before
        values["retrieval_before"] = grasp.lift_before == RETRIEVED
        values["retrieval_after"] = grasp.lift_after == RETRIEVED
    for name, value in values.items():
        if not np.isfinite(value):
            raise MechSearchError(
                f"{name} of {record.policy} on heap {record.heap_seed} is {value}; "
                "expected a finite number"
            )
    return {name: float(value) for name, value in values.items()}


def _uncovering(record: EpisodeRecord) -> dict[str, float]:
    return {
        "visibility_change": record.occlusions[0] - record.occlusions[-1],
        "uncovered_rate": record.uncovered,
        "episode_actions": len(record.actions) if record.uncovered else record.action_limit,
        "clutter_moved_m": record.clutter_moved.sum(),
        "target_moved_m": record.target_moved.sum(),
    }


def _retrieving(record: EpisodeRecord) -> dict[str, float]:
    assert record.retrieval is not None
    kinds, target = record.actions[:, 0], record.target
    carried_out = np.array([outcome != USED_UP for outcome in record.retrieval.outcomes])
    up = np.array([held == (target,) for held in record.retrieval.held])
    wrong = [bool(held) and target not in held for held in record.retrieval.held]
    # A removal that brings up the target is a lucky grasp of it.
    grasps = ((kinds == GRASP) & carried_out) | ((kinds == REMOVE) & up)
    attempts = grasps.sum()
    return {
        **{name: record.end == IN_HAND and attempts <= most for name, most in ATTEMPTS.items()},
        "grasp_attempts": attempts,
        "push_actions": ((kinds == PUSH) & carried_out).sum(),
        "removals": ((kinds == REMOVE) & carried_out & ~up).sum(),
        "clutter_moved_m": record.clutter_moved.sum(),
        "wrong_objects": ((kinds == GRASP) & wrong).sum(),
    }


def in_words(record: EpisodeRecord) -> str:
    """Return what happened, such as "95% to 0% hidden in 12 actions", or which grasps were made."""
    if record.retrieval is None:
        before, after = record.occlusions[0], record.occlusions[-1]
        return f"{before:.0%} to {after:.0%} hidden in {len(record.actions)} actions"
    pairs = zip(record.actions[:, 0].tolist(), record.retrieval.outcomes, strict=True)
    tried = [(k, outcome) for k, outcome in pairs if outcome != USED_UP]
    words = []
    for kind in (PUSH, REMOVE, GRASP):
        name, outcomes = DECISION_NAMES[kind], [outcome for k, outcome in tried if k == kind]
        if outcomes:
            several = "pushes" if kind == PUSH else f"{name}s"
            number = f"{len(outcomes)} {name if len(outcomes) == 1 else several}"
            runs = [(said, len([*same])) for said, same in groupby(outcomes)]
            said = ", ".join(f"{n} {outcome}" if n > 1 else outcome for outcome, n in runs)
            words.append(number if kind == PUSH else f"{number} ({said})")
    return f"{record.occlusions[0]:.0%} hidden at the start; {', '.join(words) or 'nothing done'}"


def in_brief(record: EpisodeRecord) -> str:
    """Return what happened, how it ended, and the reward; see `in_words`."""
    return f"{in_words(record)} ({record.end}), reward {record.rewards.sum():.1f}"


def mean_interval(values: ArrayLike) -> Estimate:
    """Return the mean of values (n,) with Student's t interval."""
    x = _checked(values)
    mean, n = float(x.mean()), len(x)
    if n == 1:
        return Estimate(mean, float("nan"), float("nan"), 1)
    half = float(stats.t.ppf((1 + CONFIDENCE) / 2, n - 1) * x.std(ddof=1) / np.sqrt(n))
    return Estimate(mean, mean - half, mean + half, n)


def share_interval(outcomes: ArrayLike) -> Estimate:
    """Return the share of outcomes (n,), each 0 or 1, with Wilson's score interval."""
    x = _checked(outcomes)
    share, n = float(x.mean()), len(x)
    z = float(stats.norm.ppf((1 + CONFIDENCE) / 2))
    centre = (share + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z * np.sqrt(share * (1 - share) / n + (z / (2 * n)) ** 2) / (1 + z**2 / n)
    # Rounding may put an end past the share itself where all outcomes are alike.
    low, high = min(share, float(centre - half)), max(share, float(centre + half))
    return Estimate(share, max(0.0, low), min(1.0, high), n)


def score(records: Iterable[EpisodeRecord]) -> dict[str, Estimate]:
    """Return every metric over all the episodes.

    Raises:
        MechSearchError: If there are none, or grasps were tried in only some of them.
    """
    return estimates([measure(record) for record in records])


def estimates(measured: Sequence[Mapping[str, float]]) -> dict[str, Estimate]:
    """Return every metric over all the episodes, of which `measured` has the values of each.

    Raises:
        MechSearchError: As `score`.
    """
    if not measured:
        raise MechSearchError("there is no episode to score; expected at least one")
    grasped = sum("graspability_change" in values for values in measured)
    if 0 < grasped < len(measured):
        raise MechSearchError(
            f"grasps were tried in {grasped} of {len(measured)} episodes; expected all or none"
        )
    return {
        name: (share_interval if name in SHARES else mean_interval)(
            [values[name] for values in measured]
        )
        for name in measured[0]
    }


def logged(scores: Mapping[str, Estimate]) -> dict[str, float]:
    """Return scores as a run logs them: the means by metric.

    `<metric>_ci_low`, `<metric>_ci_high` and the number of `heaps` follow.
    """
    found: dict[str, float] = {name: estimate.mean for name, estimate in scores.items()}
    found |= {f"{name}_ci_low": estimate.ci_low for name, estimate in scores.items()}
    found |= {f"{name}_ci_high": estimate.ci_high for name, estimate in scores.items()}
    return found | {"heaps": next(iter(scores.values())).heaps}


def score_by_count(records: Sequence[EpisodeRecord]) -> dict[int, dict[str, Estimate]]:
    """Return every metric by the number of objects in the heap, fewest first."""
    counts = sorted({record.count for record in records})
    return {count: score(r for r in records if r.count == count) for count in counts}


def _checked(values: ArrayLike) -> Floats:
    x: Floats = np.asarray(values, dtype=np.float64).reshape(-1)
    if not len(x):
        raise MechSearchError("there is nothing to average; expected at least one value")
    return x


@dataclass(frozen=True, order=True)
class SummaryRow:
    """One score; the first six fields name it, and a later row of that name replaces it.

    Attributes:
        experiment: Name of the comparison that the row belongs to.
        condition: Condition of the heaps, such as "single".
        variant: Such as "method", "ddpg", "teacher-straight", "random".
        seed: Training seed, or evaluation seed where nothing was trained.
        actions: Training actions behind the policy; 0 where nothing was trained.
        metric: Name in `METRICS`, `GRASP_METRICS`, `RETRIEVAL_METRICS` or `CEILING_METRICS`.
        mean: Over the held-out heaps.
        ci_low: Lower end of the 95 % interval over heaps.
        ci_high: Upper end.
    """

    experiment: str
    condition: str
    variant: str
    seed: int
    actions: int
    metric: str
    mean: float
    ci_low: float
    ci_high: float

    @property
    def key(self) -> tuple[str, str, str, int, int, str]:
        """What names the row."""
        return self.experiment, self.condition, self.variant, self.seed, self.actions, self.metric


def metrics_of(scores: Container[str]) -> tuple[str, ...]:
    """Return the names of the scores that are reported, reward terms apart, in their order."""
    names = RETRIEVAL_METRICS if "push_actions" in scores else METRICS
    return tuple(name for name in (*names, *GRASP_METRICS) if name in scores)


SUMMARY_COLUMNS = tuple(field.name for field in fields(SummaryRow))


def summary_rows(experiment: str, evaluation: Evaluation) -> list[SummaryRow]:
    """Return the rows that an evaluation enters into a summary.

    There is one for each of `METRICS`, and of `GRASP_METRICS` where they were measured; of
    retrieval there is one for each of `RETRIEVAL_METRICS`.
    """
    header, scores = evaluation.header, score(evaluation.episodes)
    seed = header["training_seed"] if header["trained"] else header["seed"]
    seed = header["seed"] if seed is None else seed
    place = (experiment, header["condition"], header["name"], seed, header["training_actions"])
    return [
        SummaryRow(*place, name, scores[name].mean, scores[name].ci_low, scores[name].ci_high)
        for name in metrics_of(scores)
    ]


def read_summary(path: Path) -> list[SummaryRow]:
    """Return the rows of a summary, in the file's order.

    Raises:
        MechSearchError: If the file is missing or not a summary; the message names the line.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            lines = list(csv.reader(file))
    except FileNotFoundError:
        raise MechSearchError(f"no summary at {path}") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise MechSearchError(f"the summary at {path} cannot be read: {error}") from None
    if not lines or tuple(lines[0]) != SUMMARY_COLUMNS:
        found = ",".join(lines[0]) if lines else "nothing"
        raise MechSearchError(f"{path} begins with {found}; expected {','.join(SUMMARY_COLUMNS)}")
    return [_row(path, number, line) for number, line in enumerate(lines[1:], start=2)]


def check_summary(path: Path | None) -> None:
    """Refuse a table that scores cannot be entered into, before there are any.

    Raises:
        MechSearchError: If the file is there but is not a summary.
    """
    if path and path.exists():
        read_summary(path)


def merge_summary(path: Path, new: Iterable[SummaryRow]) -> list[SummaryRow]:
    """Add rows to a summary, replacing those of the same name, and return all, sorted.

    The file is written whole; one that cannot be read is left as it is. Processes that merge at the
    same time wait for each other, and no row is lost.

    Raises:
        MechSearchError: If the file is there but is not a summary.
    """
    with locked(path):
        rows = [*(read_summary(path) if path.exists() else []), *new]
        merged = [row for _, row in sorted({row.key: row for row in rows}.items())]
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerows([SUMMARY_COLUMNS, *map(_cells, merged)])
        write_text(path, text.getvalue())
    return merged


def _cells(row: SummaryRow) -> list[str]:
    return [f"{cell:.6g}" if isinstance(cell, float) else str(cell) for cell in astuple(row)]


def _row(path: Path, number: int, cells: list[str]) -> SummaryRow:
    try:
        experiment, condition, variant, seed, actions, metric, *numbers = cells
        names, counts = (experiment, condition, variant), (int(seed), int(actions))
        mean, low, high = map(float, numbers)
        return SummaryRow(*names, *counts, metric, mean, low, high)
    except ValueError:
        raise MechSearchError(
            f"line {number} of {path} is {','.join(cells)!r}; expected {','.join(SUMMARY_COLUMNS)}"
        ) from None
