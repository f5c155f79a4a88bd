"""`plus`: clone a look-ahead expert, then correct the clone where it goes (DAgger)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mechsearch.agent.cloner import Cloner, cosine_rate
from mechsearch.agent.policy import ActorPolicy
from mechsearch.agent.weights import Archive, part, prefixed
from mechsearch.parallel import Progress, silent
from mechsearch.train.checkpoint import RunDirectory, generator_state, restore_generator
from mechsearch.train.collector import Env, Parts
from mechsearch.train.config import TrainConfig
from mechsearch.train.demonstrations import Demonstration, DemonstrationStore, evenly_spread
from mechsearch.train.evaluate import evaluate, label
from mechsearch.train.log import RunLog
from mechsearch.train.samples import Samples
from mechsearch.train.speed import Speed
from mechsearch.types import select

Expert = Callable[[Env], tuple[Demonstration | None, int]]
"""Acts from the environment's present state to the episode's end, and counts the actions that it
simulated; None where it knows no way."""

CORRECTIONS = "corrections"


@dataclass
class ImitationRun:
    """A cloner, its samples, and how far it is.

    Attributes:
        config: The run.
        cloner: The actor that imitates.
        samples: What it imitates.
        validation: What measures it.
        rng: Draws batches and episodes.
        counts: Updates, executed and simulated actions (demonstrations included), and episodes
            corrected.
    """

    config: TrainConfig
    cloner: Cloner
    samples: Samples
    validation: Samples | None
    rng: np.random.Generator
    counts: dict[str, int] = field(
        default_factory=lambda: {"updates": 0, "executed": 0, "simulated": 0, "episodes": 0}
    )

    @classmethod
    def of(cls, config: TrainConfig, demonstrations: Sequence[Demonstration]) -> "ImitationRun":
        """Set up a run; an even share of the demonstrations is kept apart for validation."""
        torch.set_num_threads(config.threads)
        torch.manual_seed(config.seed)
        learnt, apart = _split(demonstrations, config.imitation.validation_share)
        samples = Samples(learnt, config.actor_keys)
        validation = Samples(apart, config.actor_keys) if apart else None
        cloner = Cloner(
            samples.shapes, config.learner.network, config.imitation.cloner, config.seed
        )
        run = cls(config, cloner, samples, validation, np.random.default_rng(config.seed))
        run.counts["executed"] = sum(d.executed_actions for d in demonstrations)
        run.counts["simulated"] = sum(d.simulated_actions for d in demonstrations)
        return run

    def update(self, rate: float) -> dict[str, float]:
        """Take one gradient step at a share of the highest learning rate."""
        batch = self.samples.draw(self.config.imitation.cloner.batch, self.rng)
        self.counts["updates"] += 1
        return self.cloner.update(*batch, rate)

    def policy(self) -> ActorPolicy:
        """Return the actor as it is now; one that learnt turned views is asked about all."""
        symmetric = self.config.imitation.cloner.symmetry
        return ActorPolicy(self.cloner.average, self.counts["executed"], symmetric)

    def archive(self) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
        """Return tensors and facts that `restore` takes back."""
        meta: dict[str, Any] = {"counts": dict(self.counts), "generator": generator_state(self.rng)}
        return prefixed("cloner", self.cloner.state()), meta

    def restore(self, archive: Archive) -> None:
        """Go back to a checkpoint."""
        self.cloner.restore(part(archive.tensors, "cloner"))
        self.counts = {**self.counts, **archive.meta["counts"]}
        restore_generator(self.rng, archive.meta["generator"])


def _split(
    demonstrations: Sequence[Demonstration], share: float
) -> tuple[list[Demonstration], list[Demonstration]]:
    """Return demonstrations to learn from, and an evenly spread share to measure with."""
    apart = evenly_spread(len(demonstrations), round(share * len(demonstrations)))
    learnt = [d for i, d in enumerate(demonstrations) if i not in set(apart)]
    return learnt, [demonstrations[i] for i in apart]


def imitate(
    config: TrainConfig,
    demonstrations: Sequence[Demonstration],
    directory: Path,
    parts: Parts,
    expert: Expert | None = None,
    resume: bool = False,
    progress: Progress = silent,
) -> dict[str, float]:
    """Clone an expert and write the run directory; return the last evaluation.

    Args:
        config: The run; `imitation` says how.
        demonstrations: What to imitate.
        directory: Where the run is written.
        parts: Evaluators; environment and heaps too where corrections are asked for.
        expert: Takes over for corrections.
        resume: Go on from the last checkpoint.
        progress: Told after each update and each corrected episode.

    Raises:
        MechSearchError: If the directory holds another run, or the samples do not fit.
    """
    directory_of_run = RunDirectory(directory)
    run = ImitationRun.of(config, demonstrations)
    checkpoint = directory_of_run.open(config, resume)
    if checkpoint:
        run.restore(checkpoint)
    log = RunLog(directory, checkpoint)
    scores = _clone(run, directory_of_run, parts, log, progress)
    if expert and run.counts["executed"] < config.imitation.executed_actions:
        scores = _correct(run, directory_of_run, parts, expert, log, progress)
    log.close()
    return scores


def _clone(
    run: ImitationRun, files: RunDirectory, parts: Parts, log: RunLog, progress: Progress
) -> dict[str, float]:
    total, scores = run.config.imitation.updates, {}
    speed = Speed(0, run.counts["updates"])
    while run.counts["updates"] < total:
        with speed.updating():
            metrics = run.update(cosine_rate(run.counts["updates"] / total))
        done = run.counts["updates"]
        if done % 50 == 0 or done == total:
            log.write("imitation", done, metrics)
        if done % run.config.evaluate_every == 0 or done == total:
            log.write_speed(done, speed.lap(0, done))
            scores = _scored(run, files, parts, log)
        if done % run.config.checkpoint_every == 0 or done == total:
            files.save(done, *run.archive(), log.size)
        progress(label(f"{run.config.name} imitates", scores), done, total)
    return scores


def _scored(run: ImitationRun, files: RunDirectory, parts: Parts, log: RunLog) -> dict[str, float]:
    step = run.counts["updates"]
    if run.validation:
        rows = np.arange(min(len(run.validation), 1024))
        log.write("validation_error", step, run.cloner.error(*run.validation.take(rows)))
    policy = run.policy()
    files.save_actor(step, policy)
    return evaluate(policy, step, parts.evaluators, log)


def _correct(
    run: ImitationRun,
    files: RunDirectory,
    parts: Parts,
    expert: Expert,
    log: RunLog,
    progress: Progress,
) -> dict[str, float]:
    """Let the actor lead and the expert take over, and clone what it does there (DAgger)."""
    plan, counts, scores = run.config.imitation, run.counts, {}
    store = DemonstrationStore(files.path / CORRECTIONS)
    store.open({"of": run.config.name})
    run.samples.add(store.read(name) for name in store.names()[: counts["episodes"]])
    while counts["executed"] < plan.executed_actions:
        before = counts["executed"]
        correction = _corrected_episode(run, parts, expert)
        if correction is not None:
            store.write(f"{counts['episodes']:06d}", correction)
            run.samples.add([correction])
            counts["episodes"] += 1
        for _ in range(round((counts["executed"] - before) * plan.updates_per_action)):
            run.update(plan.corrected_rate)
        log.write("corrections", counts["updates"], dict(counts))
        over = counts["executed"] >= plan.executed_actions
        every = run.config.evaluate_every
        if over or counts["executed"] // every > before // every:
            scores = _scored(run, files, parts, log)
            files.save(counts["updates"], *run.archive(), log.size)
        done = min(counts["executed"], plan.executed_actions)
        progress(label(f"{run.config.name} is corrected", scores), done, plan.executed_actions)
    return scores


def _corrected_episode(run: ImitationRun, parts: Parts, expert: Expert) -> Demonstration | None:
    """Let the actor act for a random while and the expert finish; return the expert's part."""
    env, rng = parts.env, run.rng
    # The bare actor strays further than the averaged one, and shows more to correct.
    actor = ActorPolicy(run.cloner.average)
    heap, seed = int(rng.choice(parts.heaps)), int(rng.integers(2**31))
    obs, _ = env.reset(seed=seed, options={"heap": heap})
    for _ in range(int(rng.integers(run.config.imitation.longest_lead + 1))):
        obs, _, terminated, truncated, _ = env.step(actor.act(select(obs, actor.keys)))
        run.counts["executed"] += 1
        if terminated or truncated:
            return None
    correction, simulated = expert(env)
    run.counts["simulated"] += simulated
    if correction is not None:
        run.counts["executed"] += correction.executed_actions
    return correction
