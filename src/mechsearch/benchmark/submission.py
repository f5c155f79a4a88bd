"""A submission: what a policy did on every heap of a split, what it claims, and its card.

It holds no poses: they, and with them every reward, end and lift, come out of playing the actions
again. What enters the table is what the replay gives.
"""

import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from mechsearch.benchmark.environment import fixed_task, open_split
from mechsearch.benchmark.protocol import (
    BENCHMARK_SPLITS,
    BENCHMARK_TASKS,
    HEAPS_FOLDER,
    BenchmarkTask,
    Split,
    entry,
)
from mechsearch.env import HeapEnvConfig, RetrievalTask, RetrieveConfig, TaskConfig, task_from_json
from mechsearch.evaluation.episodes import (
    EpisodeRecord,
    Evaluation,
    estimates,
    load_episodes,
    measure,
)
from mechsearch.evaluation.policies import policy_named
from mechsearch.evaluation.rollout import (
    EvaluationPlan,
    differing,
    evaluate_plan,
    in_task,
    play_all,
)
from mechsearch.files import (
    ARRAY_DAMAGE,
    crossed,
    fingerprint,
    locked,
    read_arrays,
    record_from_json,
    write_whole,
)
from mechsearch.findings.tables import score_table, to_markdown
from mechsearch.heaps.dataset import HeapSet, load_heaps
from mechsearch.processes import Mapper, Progress, map_in_order, silent
from mechsearch.types import PUSH, Array, MechSearchError

SUBMISSION_FORMAT = 1
SUFFIX = ".npz"

TOLERANCE = 1e-5
"""How far a score may be from what the replay gives, relative to it where it is above 1: claims
have 32 bits."""

DIFFERING = 0.1
"""Share of episodes whose replay may differ on a processor, or with versions, other than those of
the submission: contacts turn rounding into another course of events."""


@dataclass(frozen=True)
class SubmissionCard:
    """Who submits what, and what was seen.

    Attributes:
        name: Of the submission, which is a file's too.
        authors: Who submits it.
        task: Of `protocol.BENCHMARK_TASKS`.
        task_version: The task's version.
        split: Of `protocol.BENCHMARK_SPLITS`.
        heap_set: Hash of the heap set.
        keys: Observation keys that the policy reads.
        image_size: Side of its images [px].
        grippers: Names of those that retrieve.
        seed: Of the policy's own randomness.
        privileged: Whether its training used what only a simulator knows.
        executed_actions: In its training.
        tried_actions: In its training, in copies of the simulator.
        training_heaps: Hashes of the heap sets that it, or a network that it uses, learnt on.
        training_objects: Names of the objects in them.
        weights: Where the weights, or the code, are to be had; empty if they are not.
        package: Version of mechsearch.
        fingerprint: What the bits depend on; see `files.fingerprint`.
    """

    name: str
    authors: str
    task: str
    task_version: int
    split: str
    heap_set: str
    keys: tuple[str, ...]
    image_size: int
    grippers: tuple[str, ...]
    seed: int
    privileged: bool
    executed_actions: int
    tried_actions: int
    training_heaps: tuple[str, ...]
    training_objects: tuple[str, ...]
    weights: str
    package: str
    fingerprint: dict[str, str]

    def __post_init__(self) -> None:
        if not re.fullmatch(r"\w[\w.+-]*", self.name):
            raise MechSearchError(
                f"the submission's name is {self.name!r}; expected letters, digits and . _ + -"
            )
        if not self.authors.strip():
            raise MechSearchError(f"the card of {self.name} names no authors")
        if min(self.executed_actions, self.tried_actions) < 0:
            raise MechSearchError(f"the card of {self.name} counts fewer than 0 actions")
        task, split = _entries(self.task, self.split)
        if self.task_version != task.version:
            raise MechSearchError(
                f"{self.name} is of version {self.task_version} of the task {self.task}; this is "
                f"version {task.version}"
            )
        if self.heap_set != split.heap_set:
            raise MechSearchError(
                f"{self.name} is on the heap set {self.heap_set[:12]}; the split {self.split} is "
                f"the heap set {split.heap_set[:12]}"
            )
        _check_unseen(self.name, self.split, self.training_objects)


@dataclass(frozen=True)
class ClaimedEpisode:
    """What was done on one heap, and what is said to have come of it.

    Attributes:
        heap_seed: Seed of the heap.
        condition: Such as "single".
        policy: Name of the submission.
        actions: Commands (T, 3) float32, or decisions (T, 9) float64.
        end: How it ended; see `EpisodeRecord`.
        scores: Those of `measure`.
    """

    heap_seed: int
    condition: str
    policy: str
    actions: Array
    end: str
    scores: Mapping[str, float]


@dataclass(frozen=True)
class Submission:
    """Episodes and their card.

    Attributes:
        card: Who and what.
        claims: Of every heap of the split, in their order.
        replay: What the replay said before it was entered: the fingerprint there, and the number
            of episodes that differed; empty before.
    """

    card: SubmissionCard
    claims: tuple[ClaimedEpisode, ...]
    replay: Mapping[str, Any]


@dataclass(frozen=True)
class Entrant:
    """Who enters what, as the card needs it.

    Attributes:
        task: Such as uncover.
        split: Such as single.
        authors: Who submits it.
        name: Of the submission; by default the policy's own.
        gripper: Of policies that retrieve, such as jaws-85, or several joined by a plus sign.
        seed: Of the policy's own randomness.
        training_heaps: Heap sets (.parquet) that the policy, or a network that it uses, learnt on;
            their training halves count.
        privileged: Whether training used what only a simulator knows.
        executed: Actions executed in training; by default what a trained policy says.
        tried: Actions tried in training in copies of the simulator.
        weights: Where weights or code are to be had.
    """

    task: str
    split: str
    authors: str
    name: str = ""
    gripper: str = ""
    seed: int = 0
    training_heaps: tuple[Path, ...] = ()
    privileged: bool = False
    executed: int | None = None
    tried: int = 0
    weights: str = ""


def act(
    policy: str,
    entrant: Entrant,
    folder: Path = Path(HEAPS_FOLDER),
    objects: str = "",
    workers: int = 1,
    progress: Progress = silent,
    mapper: Mapper = map_in_order,
) -> Submission:
    """Return what a policy does on every heap of a split, with its card.

    Args:
        policy: As for `make_policy`, or a file of episodes recorded on the split's heaps (.npz).
        entrant: Who enters it, and where.
        folder: Where the heap sets are.
        objects: Object set; empty takes the one that the heaps name.
        workers: Processes.
        progress: Told after each episode.
        mapper: How the episodes are spread.

    Raises:
        MechSearchError: If the policy is not for this task, has learnt on objects that it must not
            know, or the card is no good; as far as possible before it acts.
    """
    task, split = _entries(entrant.task, entrant.split)
    file, heap_set = open_split(entrant.split, folder, objects)
    learnt_on = [load_heaps(path) for path in entrant.training_heaps]
    names = {name for heaps in learnt_on for heap in heaps.train for name in heap.objects}
    name = entrant.name or policy
    _check_unseen(name, entrant.split, names)
    if not entrant.authors.strip():
        raise MechSearchError(f"{name} names no authors")

    def fixed(own: TaskConfig) -> TaskConfig:
        if isinstance(own, RetrievalTask) != task.retrieves:
            raise MechSearchError(
                f"{policy} {'uncovers' if task.retrieves else 'retrieves'}; expected a "
                f"policy for the task {entrant.task}"
            )
        grippers = own.grippers if isinstance(own, RetrievalTask) else ()
        return fixed_task(entrant.task, entrant.split, heap_set.camera, own.image_size, grippers)

    if policy.endswith(SUFFIX):
        evaluation = load_episodes(Path(policy))
        learnt = evaluation.header["trained"]
    else:
        learnt = hasattr(policy_named(policy), "training_actions")
    if (learnt or task.retrieves) and not learnt_on:
        raise MechSearchError(
            f"{name} has learnt, or uses networks that have; name the heap sets by --training-heaps"
        )
    if not policy.endswith(SUFFIX):
        plan = EvaluationPlan(
            policy, file, entrant.name, objects, split.part, split.limit, entrant.seed,
            grippers=tuple(entrant.gripper.split("+")) if entrant.gripper else (),
        )  # fmt: skip
        evaluation = evaluate_plan(in_task(plan, fixed), workers, progress, mapper)
    header = evaluation.header
    told = {
        "name": entrant.name or header["name"],
        "authors": entrant.authors,
        "privileged": entrant.privileged,
        "executed_actions": (
            header["training_actions"] if entrant.executed is None else entrant.executed
        ),
        "tried_actions": entrant.tried,
        "training_heaps": tuple(heaps.hash for heaps in learnt_on),
        "training_objects": tuple(sorted(names)),
        "weights": entrant.weights,
    }
    made = submission_of(evaluation, entrant.task, entrant.split, told, heap_set.camera)
    _check_heaps(made, heap_set)
    return made


def _entries(task: str, split: str) -> tuple[BenchmarkTask, Split]:
    return entry(BENCHMARK_TASKS, "task", task), entry(BENCHMARK_SPLITS, "split", split)


def _check_unseen(name: str, split: str, training_objects: Iterable[str]) -> None:
    known = sorted(set(BENCHMARK_SPLITS[split].unseen) & set(training_objects))
    if known:
        raise MechSearchError(
            f"{name} cannot enter the split {split}: its training heaps held {', '.join(known)}; "
            "docs/benchmark.md says how to make heaps without them"
        )


def submission_of(
    evaluation: Evaluation, task: str, split: str, told: Mapping[str, Any], camera: str
) -> Submission:
    """Return recorded episodes as a submission.

    Args:
        evaluation: The episodes.
        task: Of `BENCHMARK_TASKS`.
        split: Of `BENCHMARK_SPLITS`.
        told: Fields of the card that the episodes do not say.
        camera: That of the split's heaps.

    Raises:
        MechSearchError: If they are of another task or other heaps, or the card is no good.
    """
    header = evaluation.header
    kind = RetrieveConfig if header.get("goal") == "retrieve" else HeapEnvConfig
    acted = task_from_json(kind, header["env"])
    grippers = acted.grippers if isinstance(acted, RetrievalTask) else ()
    fixed = _config(task, split, camera, acted.image_size, grippers)
    if type(acted) is not type(fixed):
        raise MechSearchError(
            f"{header['name']} has episodes of another task than {task}; choose the one that its "
            "policy is for"
        )
    # What was looked at is the policy's own.
    alike = replace(acted, keys=fixed.keys, privileged=False, max_clutter=0)
    others = differing(fixed, alike)
    if others:
        raise MechSearchError(f"{header['name']} acted in another task: {', '.join(others)}")
    card = SubmissionCard(
        task=task,
        task_version=BENCHMARK_TASKS[task].version,
        split=split,
        heap_set=header["heap_set"],
        keys=tuple(header["keys"]),
        image_size=acted.image_size,
        grippers=grippers,
        seed=header["seed"],
        package=header["version"],
        fingerprint=dict(header["fingerprint"]),
        **told,
    )
    claims = tuple(_claim(record, card.name) for record in evaluation.episodes)
    return Submission(card, claims, {})


def _claim(record: EpisodeRecord, name: str) -> ClaimedEpisode:
    actions = record.actions.copy()
    # The environments clip a push just so.
    pushes = actions[:, 0] == PUSH if record.retrieval else np.ones(len(actions), np.bool_)
    part = slice(2, 5) if record.retrieval else slice(None)
    actions[pushes, part] = np.clip(actions[pushes, part], -1.0, 1.0)
    # What a gripper could do before and after is no part of these tasks.
    scores = measure(replace(record, grasp=None))
    return ClaimedEpisode(record.heap_seed, record.condition, name, actions, record.end, scores)


def save_submission(path: Path, submission: Submission) -> None:
    """Write a submission, whole or not at all; the same one gives the same bytes."""
    claims = submission.claims
    metrics = tuple(claims[0].scores)
    text = {
        "format": SUBMISSION_FORMAT,
        "card": asdict(submission.card),
        "replay": dict(submission.replay),
        "metrics": metrics,
        "dtype": claims[0].actions.dtype.str,
        "heaps": [[claim.heap_seed, claim.condition] for claim in claims],
        "lengths": [len(claim.actions) for claim in claims],
        "ends": [claim.end for claim in claims],
    }
    scores = np.array([[claim.scores[name] for name in metrics] for claim in claims], "<f4")
    arrays = {
        "text": np.frombuffer(json.dumps(text, sort_keys=True).encode(), np.uint8),
        "actions": _planes(np.concatenate([claim.actions for claim in claims])),
        "scores": _planes(scores),
    }

    def write(partial: Path) -> None:
        with partial.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)

    write_whole(path, write)


def load_submission(path: Path) -> Submission:
    """Read a submission; nothing in the file is ever run.

    Raises:
        MechSearchError: If the file is missing, damaged, or no submission to the benchmark as this
            version has it.
    """
    arrays = read_arrays(path, "submission")
    try:
        text = json.loads(arrays["text"].tobytes())
        if text["format"] != SUBMISSION_FORMAT:
            raise MechSearchError(
                f"{path} has submission format {text['format']}; this version reads "
                f"{SUBMISSION_FORMAT}"
            )
        card = _card(path, text["card"])
        width, lengths = (9 if card.grippers else 3), np.array(text["lengths"])
        actions = _whole(arrays["actions"], text["dtype"]).reshape(-1, width)
        scores = _whole(arrays["scores"], "<f4").reshape(len(lengths), -1).astype(np.float64)
        if lengths.min() < 1 or lengths.sum() != len(actions):
            raise ValueError(f"{len(actions)} actions in episodes of {lengths.sum()}")
        parts = np.split(actions, np.cumsum(lengths)[:-1])
        claims = tuple(
            ClaimedEpisode(int(seed), str(condition), card.name, acts, str(end),
                  dict(zip(text["metrics"], row.tolist(), strict=True)))
            for (seed, condition), acts, end, row in zip(
                text["heaps"], parts, text["ends"], scores, strict=True
            )
        )  # fmt: skip
        return Submission(card, claims, text["replay"])
    except (*ARRAY_DAMAGE, AttributeError) as error:
        raise MechSearchError(f"{path} is damaged or no submission: {error}") from None


def _card(path: Path, told: Mapping[str, Any]) -> SubmissionCard:
    missing = [entry.name for entry in fields(SubmissionCard) if entry.name not in told]
    if missing:
        raise MechSearchError(f"the card of {path} lacks {', '.join(missing)}")
    return record_from_json(SubmissionCard, told)


def _planes(values: Array) -> Array:
    """Return the bytes of numbers, all first ones first: like bytes beside each other pack well."""
    flat = np.ascontiguousarray(values).reshape(-1)
    return np.ascontiguousarray(flat.view(np.uint8).reshape(-1, flat.itemsize).T)


def _whole(planes: Array, dtype: str) -> Array:
    if dtype not in ("<f4", "<f8"):
        raise ValueError(f"numbers of type {dtype!r}")
    return np.ascontiguousarray(planes.T).reshape(-1).view(dtype)


def _config(
    task: str, split: str, camera: str, image_size: int, grippers: Sequence[str]
) -> HeapEnvConfig:
    fixed = fixed_task(task, split, camera, image_size, grippers)
    kind = RetrieveConfig if isinstance(fixed, RetrievalTask) else HeapEnvConfig
    return kind.of_task(fixed, ())


def verified(
    submission: Submission,
    folder: Path = Path(HEAPS_FOLDER),
    objects: str = "",
    workers: int = 1,
    progress: Progress = silent,
    mapper: Mapper = map_in_order,
) -> Submission:
    """Return a submission with the ends and scores that its actions give here.

    Where package, processor and threads are those of the submission every episode must come out as
    claimed. Elsewhere a share of `DIFFERING` may come out otherwise: then the replay counts, and an
    episode that is not over after its last action goes on without any.

    Args:
        submission: What is claimed.
        folder: Where the heap sets are.
        objects: Object set; empty takes the one that the heaps name.
        workers: Processes.
        progress: Told after each episode.
        mapper: How the episodes are spread.

    Raises:
        MechSearchError: If heaps are missing or foreign, an action is beyond its bounds, or too
            many episodes come out otherwise; it names the first and by how much.
    """
    card = submission.card
    file, heap_set = open_split(card.split, folder, objects)
    _check_heaps(submission, heap_set)
    _check_bounds(submission)
    elsewhere = crossed(card.fingerprint, now := fingerprint())
    config = _config(card.task, card.split, heap_set.camera, card.image_size, card.grippers)
    again = play_all(
        f"{card.name} played again", submission.claims, config, file, objects, workers, progress,
        mapper, idle=bool(elsewhere),
    )  # fmt: skip
    claims, wrong, furthest = [], [], 0.0
    for claim, played in zip(submission.claims, again, strict=True):
        if isinstance(played, str):
            raise MechSearchError(f"{card.name} on heap {claim.heap_seed}: {played}")
        found = replace(claim, actions=played.actions, end=played.end, scores=measure(played))
        said, distance = _differences(claim, found)
        furthest = max(furthest, distance)
        if said:
            wrong.append(f"on heap {claim.heap_seed}: {said}")
        claims.append(found)
    allowed = DIFFERING * len(claims) if elsewhere else 0
    if len(wrong) > allowed:
        here = f"; here it is {', '.join(elsewhere)}" if elsewhere else ""
        raise MechSearchError(
            f"{card.name} is not what its actions give, in {len(wrong)} of {len(claims)} episodes "
            f"({int(allowed)} may differ, scores by up to {furthest:.3g} where {TOLERANCE:g} is "
            f"rounding): {wrong[0]}{here}"
        )
    return Submission(
        card, tuple(claims), {"fingerprint": now, "differing": len(wrong), "furthest": furthest}
    )


def is_submission(path: Path) -> bool:
    """Return whether a file (.npz) is a submission, and no evaluation.

    Raises:
        MechSearchError: If it is missing, or damaged.
    """
    return "scores" in read_arrays(path, "evaluation")


def played(
    submission: Submission, heap_seed: int, folder: Path = Path(HEAPS_FOLDER), objects: str = ""
) -> Evaluation:
    """Return the episode on one heap, played again, for pictures; its scores are not checked.

    Args:
        submission: What was done.
        heap_seed: Seed of the heap.
        folder: Where the heap sets are.
        objects: Object set; empty takes the one that the heaps name.

    Raises:
        MechSearchError: If heaps or objects are missing or foreign, or the actions fail.
    """
    card = submission.card
    file, heap_set = open_split(card.split, folder, objects)
    config = _config(card.task, card.split, heap_set.camera, card.image_size, card.grippers)
    claims = [claim for claim in submission.claims if claim.heap_seed == heap_seed]
    again = play_all(card.name, claims, config, file, objects, idle=True)
    (record,) = again
    if isinstance(record, str):
        raise MechSearchError(f"{card.name} on heap {heap_seed}: {record}")
    header = {
        "name": card.name, "policy": card.name, "keys": list(card.keys), "seed": card.seed,
        "object_set": objects or heap_set.objects,
        "object_hashes": heap_set.manifest["object_hashes"], "env": asdict(config),
    }  # fmt: skip
    return Evaluation(header, (record,))


def _check_heaps(submission: Submission, heap_set: HeapSet) -> None:
    split = BENCHMARK_SPLITS[submission.card.split]
    chosen = [heap_set.heaps[i] for i in heap_set.choose(split.part, split.limit)]
    expected = [(heap.seed, heap.condition) for heap in chosen]
    claimed = [(claim.heap_seed, claim.condition) for claim in submission.claims]
    counts = Counter(claimed)
    foreign = [heap for heap in claimed if heap not in set(expected)]
    twice = [heap for heap, times in counts.items() if times > 1]
    missing = [heap for heap in expected if heap not in counts]
    for heaps, what in ((foreign, "is not one of"), (twice, "has more than one episode in"),
                        (missing, "has no episode in")):  # fmt: skip
        if heaps:
            more = f", and {len(heaps) - 1} more" if len(heaps) > 1 else ""
            raise MechSearchError(
                f"{submission.card.name}: heap {heaps[0][0]} {what} the split "
                f"{submission.card.split}{more}; "
                f"expected one episode on each of its {len(expected)} heaps"
            )


def _check_bounds(submission: Submission) -> None:
    for claim in submission.claims:
        actions = claim.actions
        if submission.card.grippers:
            actions = actions[actions[:, 0] == PUSH][:, 2:5]
        beyond = ~(np.abs(actions) <= 1.0)
        if beyond.any():
            raise MechSearchError(
                f"{submission.card.name} on heap {claim.heap_seed}: an action of "
                f"{actions[beyond][0]:g}; expected numbers in [-1, 1]"
            )


def _differences(claim: ClaimedEpisode, found: ClaimedEpisode) -> tuple[str, float]:
    """Return in what a claim differs from what was found, and the largest distance of a score."""
    said, furthest = [], 0.0
    if len(found.actions) != len(claim.actions):
        said.append(f"{len(claim.actions)} actions, and it is over after {len(found.actions)}")
    if found.end != claim.end:
        said.append(f"end {claim.end!r} claimed, {found.end!r} found")
    for name in dict.fromkeys((*found.scores, *claim.scores)):
        claimed, real = claim.scores.get(name, np.nan), found.scores.get(name, np.nan)
        distance = abs(claimed - real) / max(1.0, abs(real))
        if not distance <= TOLERANCE:
            said.append(f"{name} {claimed:.6g} claimed, {real:.6g} found")
            furthest = max(furthest, float(np.nan_to_num(distance, nan=np.inf)))
    return ", ".join(said), furthest


def place_of(card: SubmissionCard, results: Path) -> Path:
    """Return where a submission is once it has been entered."""
    return results / card.task / card.split / f"{card.name}{SUFFIX}"


def enter(submission: Submission, results: Path) -> Path:
    """Keep a verified submission, and return its file.

    Raises:
        MechSearchError: If it was not verified, or there is one of its name.
    """
    path = place_of(submission.card, results)
    _check_verified(path, submission)
    with locked(path):
        check_free(path)
        save_submission(path, submission)
    return path


def check_free(path: Path) -> None:
    """Refuse a submission in whose place there is one.

    Raises:
        MechSearchError: If there is.
    """
    if path.exists():
        raise MechSearchError(f"{path} is a submission already; choose another name")


def _check_verified(path: Path, submission: Submission) -> None:
    if not submission.replay:
        raise MechSearchError(f"{path} was not played again; use `mechsearch benchmark submit`")


def entered(results: Path) -> Iterator[Submission]:
    """Yield all that was entered, by task and split in their order and then by name.

    Raises:
        MechSearchError: If a file is damaged, stands in another's place, or was not verified.
    """
    for task in BENCHMARK_TASKS:
        for split in BENCHMARK_SPLITS:
            for path in sorted((results / task / split).glob(f"*{SUFFIX}")):
                submission = load_submission(path)
                _check_verified(path, submission)
                if place_of(submission.card, results) != path:
                    raise MechSearchError(
                        f"{path} is the submission {submission.card.name} to the split "
                        f"{submission.card.split} of {submission.card.task}; it belongs in "
                        f"{place_of(submission.card, results)}"
                    )
                yield submission


def page(submissions: Sequence[Submission]) -> str:
    """Return the page of all submissions, in Markdown: a table for each task and split."""
    parts = ["# Benchmark: submissions\n\n" + _HEAD]
    for task in BENCHMARK_TASKS:
        for split, known in BENCHMARK_SPLITS.items():
            here = [s for s in submissions if (s.card.task, s.card.split) == (task, split)]
            if here:
                parts.append(f"## `{task}`, `{split}`\n\n{_table(task, known.what, here)}")
    return "\n".join(parts)


def _table(task: str, what: str, submissions: Sequence[Submission]) -> str:
    cards = {s.card.name: s.card for s in submissions}
    scores = {s.card.name: estimates([c.scores for c in s.claims]) for s in submissions}
    key = BENCHMARK_TASKS[task].ranked_by
    ranked = dict(sorted(scores.items(), key=lambda item: (-item[1][key].mean, item[0])))
    facts = {
        "by": [cards[name].authors for name in ranked],
        "sees": [_seen(cards[name]) for name in ranked],
        "training": [_training(cards[name]) for name in ranked],
        "weights": [cards[name].weights or "not available" for name in ranked],
    }
    caption = f"{len(submissions[0].claims)} {what}; sorted by {key.replace('_', ' ')}."
    return to_markdown(score_table(ranked, caption, facts))


def _seen(card: SubmissionCard) -> str:
    return ", ".join((*card.keys, *card.grippers)).replace("_", " ")


def _training(card: SubmissionCard) -> str:
    if not card.training_heaps:
        return "none"
    heaps = ", ".join(f"`{digest[:8]}`" for digest in card.training_heaps)
    actions = f"{card.executed_actions:,} actions, {card.tried_actions:,} tried"
    return f"{actions}; {'privileged; ' if card.privileged else ''}heaps {heaps}"


_HEAD = (
    "Made by `mechsearch benchmark table` from the submissions in `results/benchmark`; "
    "[benchmark.md](benchmark.md) says what they are. Every number comes from playing the "
    "submitted actions again. Intervals are 95 % over heaps.\n"
)
