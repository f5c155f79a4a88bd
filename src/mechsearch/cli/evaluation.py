"""`mechsearch evaluate`, `mechsearch show` and `mechsearch verify`."""

import importlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from mechsearch.benchmark.submission import HEAPS_FOLDER, is_submission, load_submission, played
from mechsearch.cli.command import (
    PICTURES,
    Mapper,
    OfEpisodes,
    OfObjects,
    Spread,
    bars,
    models_of,
    say,
    wrote,
)
from mechsearch.cli.overrides import optional, overridden
from mechsearch.env import RetrievalTask, TaskConfig
from mechsearch.evaluation.episodes import (
    EpisodeRecord,
    Evaluation,
    check_summary,
    in_brief,
    load_episodes,
    merge_summary,
    save_episodes,
    summary_rows,
)
from mechsearch.evaluation.rollout import (
    EvaluationPlan,
    evaluate_plan,
    file_name,
    in_task,
    other_inputs,
    planned_header,
    replay_all,
    weighed_again,
)
from mechsearch.files import alone, check_place, crossed, fingerprint, write_text, write_whole
from mechsearch.findings.experiment import distinct_names, ordered
from mechsearch.findings.scores import ranked_heaps
from mechsearch.findings.tables import EPISODES_NOTE, evaluation_tables, to_text
from mechsearch.pictures.film import (
    FORMATS,
    FilmConfig,
    check_film,
    film_of,
    filmstrip,
    start_and_end,
    write_film,
)
from mechsearch.pictures.page import PAGES, Shown, episode_page
from mechsearch.pictures.replay import replayed
from mechsearch.types import MechSearchError, check_extra

_TaskOptions: Any = optional(TaskConfig)

_NOTE = (
    "Means over heaps with 95 % confidence intervals (Student's t; Wilson's for the share "
    f"uncovered). {EPISODES_NOTE}"
)


@dataclass(frozen=True)
class Evaluate(OfObjects, Spread):
    """Score policies on a heap set and record every episode.

    Each policy acts in the task of the run that it comes from, or else in the default one through
    the heap set's camera; what is said of the task is changed for all of them, such as the physics
    by --engine bullet.

    Attributes:
        policies: Each random, idle, teacher-straight, teacher-zigzag, teacher-spiral, look-ahead
            (tries the teachers' pushes in the simulator), uncover, retrieve or retrieve-dual (the
            trained policies that are shipped), a run directory, an actor's file (.safetensors), or
            package.module:factory.
        heaps: Heap set (.parquet); by default the embedded heaps of household objects, single
            ones but for the policy retrieve-dual.
        out: Folder for the recorded episodes, one file for each policy.
        name: Under which a single policy is reported; by default that of its run, or its own text.
        split: "held-out", "train" or "all" heaps.
        limit: Number of heaps, spread evenly; 0 takes all.
        seed: Of the policies' own randomness; all start alike.
        task: What is changed of the task.
        gripper: Of policies that retrieve, such as jaws-85, or several joined by a plus sign, such
            as jaws-85+suction, of which the first pushes.
        perturbed: Of policies that retrieve: whether grasps are off by what the lift test calls
            uncertain.
        summary: Table (.csv) in which to enter the scores.
        experiment: First column of that table.
        brief: Print the main scores alone.
        grasps: Also measure graspability and retrieval of each target, before and after; needs
            PyTorch.
        grasp_network: Grasp network (.safetensors or .npz) to do it with, not the shipped one.
        overwrite: Replace evaluations of the same name that were made of something else, too; those
            of the same policy, heaps, task and seed are replaced anyway.
    """

    writes = (("summary", ()),)
    behind = (_TaskOptions,)

    policies: Annotated[
        tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="POLICY [POLICY ...]")
    ]
    heaps: Path | None = None
    out: Path = Path("evaluations")
    name: str = ""
    split: str = "held-out"
    limit: int = 0
    seed: int = 0
    task: Annotated[Any, tyro.conf.arg(constructor=_TaskOptions, name="")] = field(
        default_factory=_TaskOptions
    )
    gripper: str = ""
    perturbed: bool = False
    summary: Path | None = None
    experiment: str = "main"
    brief: bool = False
    grasps: bool = False
    grasp_network: Path | None = None
    overwrite: bool = False

    def run(self) -> None:
        """Evaluate, print the scores, and write episodes and table."""
        if not self.policies or (self.name and len(self.policies) > 1):
            raise MechSearchError(
                f"{len(self.policies)} policies given; expected one with --name, or at least one"
            )
        plans = [self._plan(policy) for policy in self.policies]
        check_place(self.out / "episodes.npz")
        check_summary(self.summary)
        grasping = self._grasping()
        done: list[Evaluation] = []
        place = alone(self.out / "evaluations", f"the evaluations in {self.out}")
        with place, self.spread() as (workers, mapper):
            self._check_files(plans)
            try:
                for plan in plans:
                    done.append(self._evaluated(plan, workers, mapper, grasping))
            except KeyboardInterrupt:
                left = " ".join(self.policies[len(done) :])
                raise KeyboardInterrupt(
                    f"{len(done)} of {len(plans)} policies are scored, and their episodes kept in "
                    f"{self.out}; go on by the same command with these policies alone: {left}"
                ) from None
        self._print(named(done))
        wrote(self.out)

    def _check_files(self, plans: Iterable[EvaluationPlan]) -> None:
        """Refuse to write over an evaluation that was made of something else.

        Raises:
            MechSearchError: Naming the file, in what they differ, and the choices.
        """
        planned: dict[Path, Mapping[str, Any]] = {}
        for plan in plans:
            header = planned_header(plan)
            file = self._file(header)
            others = [planned[file]] if file in planned else []
            if file.exists() and not self.overwrite:
                others.append(load_episodes(file).header)
            for other in others:
                # Grasps that are measured again are not lost.
                again = {"grasp_network": other.get("grasp_network")} if self._grasps else {}
                if differing := other_inputs(other, header | again):
                    raise MechSearchError(
                        f"{plan.title} would take the place of {file}, of another "
                        f"{', '.join(differing)}; give it a --name of its own, choose another "
                        "--out, or replace what is there by --overwrite"
                    )
            planned[file] = header

    @property
    def _grasps(self) -> bool:
        return self.grasps or self.grasp_network is not None

    def _file(self, header: Mapping[str, Any]) -> Path:
        return self.out / f"{file_name(Evaluation(header, ()))}.npz"

    def _evaluated(
        self, plan: EvaluationPlan, workers: int, mapper: Mapper, grasping: Any
    ) -> Evaluation:
        """Return the evaluation of a plan, whose episodes and scores are written."""
        with bars() as progress:
            evaluation = evaluate_plan(plan, workers, progress, mapper)
        if evaluation.header["task_differs"]:
            say(f"{plan.title}, in another task: {', '.join(evaluation.header['task_differs'])}")
        file = self._file(evaluation.header)
        save_episodes(file, evaluation)
        if grasping:
            with bars() as progress:
                evaluation = grasping(evaluation, progress=progress)
            save_episodes(file, evaluation)
        if self.summary:
            merge_summary(self.summary, summary_rows(self.experiment, evaluation))
        return evaluation

    def _plan(self, policy: str) -> EvaluationPlan:
        """Return the plan for a policy, if it can act in the task that is asked for."""
        grippers = tuple(self.gripper.split("+")) if self.gripper else ()
        plan = EvaluationPlan(
            policy, self.heaps, self.name, self.objects, self.split, self.limit, self.seed,
            grippers=grippers,
        )  # fmt: skip
        return in_task(plan, self._changed)

    def _changed(self, task: TaskConfig) -> TaskConfig:
        """Return a task as it is asked for."""
        changed: TaskConfig = overridden(task, self.task)
        if not self.perturbed:
            return changed
        if not isinstance(changed, RetrievalTask):
            raise MechSearchError("--perturbed is for policies that retrieve")
        return replace(changed, perturbed=True)

    def _grasping(self) -> Any:
        """Return what measures grasps, if asked for; a network that is no good is refused first."""
        if not self._grasps:
            return None
        check_extra("--grasps", "learn")
        assessor = importlib.import_module("mechsearch.retrieval.assessment").assessor
        return assessor(self.grasp_network, self.objects, self.workers)

    def _print(self, evaluations: dict[str, Evaluation]) -> None:
        recorded = {name: evaluation.episodes for name, evaluation in evaluations.items()}
        say("\n".join(map(to_text, evaluation_tables(recorded, self.brief))))
        for name, evaluation in evaluations.items():
            for lost in evaluation.header.get("quarantined", ()):
                say(f"{name}: heap {lost['heap']} is left out, it failed twice: {lost['reason']}")
            if "simulated_actions" in evaluation.header:
                executed = sum(len(record.actions) for record in evaluation.episodes)
                simulated = evaluation.header["simulated_actions"]
                say(f"{name}: {executed:,} actions executed, {simulated:,} more simulated to plan")
        say(_NOTE)


@dataclass(frozen=True)
class ShowEpisode(OfObjects):
    """Draw a recorded episode: target green, path of the end effector blue.

    Grasps are carried out again to show them, phase by phase.

    Attributes:
        episodes: File that `mechsearch evaluate` wrote (.npz), or a submission to the benchmark.
        out: .png, .jpg or .webp for a picture, .gif or .mp4 for a film, .html for a page in three
            dimensions, with what the policy weighed.
        which: "worst", "median" or "best" by reward, or a heap's seed.
        frames: Of a picture: 2 shows start and end, more make a filmstrip.
        camera: "overhead" or "tilted"; by default the first for pushes alone, and for retrieval
            one from the side that shows what is lifted.
        size: Side of each frame [px].
        rate: Frames a second in a film, one for each push and eight for a second of a grasp.
        policy: Who acted, to be asked again what it weighed (.html); one that is shipped is found.
        heaps: Of a submission, which is played again: folder of the heap sets.
    """

    writes = (("out", (*PICTURES, *FORMATS, *PAGES)),)

    episodes: Annotated[Path, tyro.conf.Positional]
    out: Path = Path("episode.png")
    which: str = "median"
    frames: int = 2
    camera: str = ""
    size: int = 360
    rate: float = 6.0
    policy: str = ""
    heaps: Path = Path(HEAPS_FOLDER)

    def run(self) -> None:
        """Draw and write the episode."""
        config = FilmConfig(self.camera, self.size)
        suffix = self.out.suffix.lower()
        moving = suffix in (*FORMATS, *PAGES)
        if suffix in FORMATS:
            check_film(self.out, self.rate)
        header, record = self._episode()
        models = models_of(Evaluation(header, ()), self.objects)
        # Start and end alone show the path instead.
        robot = moving or self.frames != 2
        film = film_of(header, record, models, config, robot, replayed)
        title, words = f"{record.policy} on heap {record.heap_seed}", in_brief(record)
        if suffix in PAGES:
            with bars() as progress:
                weighed = weighed_again(header, record, models, self.policy, progress)
            shown = Shown(film, words, weighed)
            write_text(self.out, episode_page(title, {self.which: shown}, self.rate))
        elif moving:
            with bars() as progress:
                write_film(self.out, film, self.rate, progress)
        else:
            picture = start_and_end(film) if self.frames == 2 else filmstrip(film, self.frames)
            write_whole(self.out, picture.save)
        say(f"{title}: {words}")
        wrote(self.out)

    def _episode(self) -> tuple[Mapping[str, Any], EpisodeRecord]:
        """Return the header and the episode that is asked for."""
        if is_submission(self.episodes):
            submission = load_submission(self.episodes)
            rewards = {claim.heap_seed: claim.scores["reward"] for claim in submission.claims}
            evaluation = played(submission, self._heap(rewards), self.heaps, self.objects)
            return evaluation.header, evaluation.episodes[0]
        evaluation = load_episodes(self.episodes)
        records = {record.heap_seed: record for record in evaluation.episodes}
        rewards = {seed: float(record.rewards.sum()) for seed, record in records.items()}
        return evaluation.header, records[self._heap(rewards)]

    def _heap(self, rewards: Mapping[int, float]) -> int:
        """Return the heap that is asked for, of those with rewards."""
        ranked = ranked_heaps(rewards, rewards.values())
        seed = str(ranked.get(self.which, self.which))
        if seed not in map(str, rewards):
            some = ", ".join(map(str, [*rewards][:5]))
            raise MechSearchError(
                f"no episode {self.which!r} in {self.episodes}; choose one of "
                f"{', '.join(ranked)}, or a heap's seed such as {some}"
            )
        return int(seed)


@dataclass(frozen=True)
class Verify(OfEpisodes):
    """Play recorded episodes again, and prove that poses, occlusions and rewards are the same bits.

    Attributes:
        heaps: Heap set (.parquet) that they ran on.
    """

    heaps: Path

    def run(self) -> None:
        """Verify; exit with 1 if an episode differs."""
        if not self.episodes:
            raise MechSearchError("no file of episodes named; expected at least one")
        passed = [self._verify(path, evaluation) for path, evaluation in self.recorded()]
        if not all(passed):
            raise SystemExit(1)

    def _verify(self, path: Path, evaluation: Evaluation) -> bool:
        with bars() as progress:
            found = list(replay_all(evaluation, self.heaps, self.objects, self.workers, progress))
        for replay in found:
            if not replay.passed:
                say(f"{path}: heap {replay.heap_seed}: {'; '.join(replay.differences)}")
        number, same = len(found), sum(replay.passed for replay in found)
        say(f"{path}: {same} of {number} episodes are as recorded, bit by bit")
        others = crossed(evaluation.header.get("fingerprint", {}), fingerprint())
        if others:
            say(f"here it is {', '.join(others)}: bits may differ by rounding")
        return same == number


def named(evaluations: Iterable[Evaluation]) -> dict[str, Evaluation]:
    """Return evaluations by a name that tells them apart, in the order of reports."""
    listed = list(evaluations)
    found = dict(zip(distinct_names([e.header for e in listed]), listed, strict=True))
    return {name: found[name] for name in ordered(found)}
