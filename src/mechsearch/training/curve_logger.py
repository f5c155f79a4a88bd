"""Learning curves of any learner, whatever it is written in: the records that reports draw."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from mechsearch.env import TaskConfig
from mechsearch.evaluation.episodes import Evaluation, logged, save_episodes, score
from mechsearch.evaluation.rollout import EvaluationPlan, evaluate_plan
from mechsearch.files import CONFIG_FILE, INPUTS_FILE, METRICS_FILE, append_line, write_record
from mechsearch.types import ACTOR_KEYS, Array, MechSearchError, Observation, Policy


class CurveLogger:
    """Notes episodes and evaluations on held-out heaps in a run directory.

    `mechsearch report FOLDER` draws its curve, and scores its last policy among the others.
    """

    def __init__(
        self,
        directory: str | Path,
        name: str,
        seed: int = 0,
        heaps: str | Path | None = None,
        objects: str = "",
        limit: int = 0,
        task: TaskConfig | None = None,
        workers: int = 1,
    ) -> None:
        """Begin a run directory.

        Args:
            directory: To write.
            name: Under which the learner is reported.
            seed: Of its training.
            heaps: Heap set file, on whose held-out heaps it is scored; None takes the embedded
                heaps of household objects.
            objects: Object set; empty takes the one that the heap set names.
            limit: Number of held-out heaps, spread evenly; 0 takes all.
            task: The task; None takes the default one through the heap set's camera.
            workers: Processes that score; more than one needs a policy that pickles.

        Raises:
            MechSearchError: If the directory holds a run already.
        """
        self.directory, self.name, self.seed = Path(directory), name, seed
        self._heaps, self._objects = None if heaps is None else Path(heaps), objects
        self._limit, self._task, self._workers = limit, task, workers
        if (self.directory / CONFIG_FILE).exists():
            raise MechSearchError(f"{self.directory} holds a run already; name another")
        known = {"task": asdict(task)} if task else {}
        record = {"name": name, "seed": seed, **known}
        write_record(self.directory / CONFIG_FILE, "training configuration", record)

    def episode(self, step: int, reward: float, actions: int) -> None:
        """Note an episode of the training.

        Args:
            step: Actions executed so far.
            reward: Sum over the episode.
            actions: Of the episode.
        """
        self._append("episode", step, {"return": float(reward), "length": int(actions)})

    def evaluate(
        self,
        step: int,
        policy: Policy | Callable[[Observation], Array],
        keys: Sequence[str] = ACTOR_KEYS,
    ) -> dict[str, float]:
        """Score a policy on held-out heaps, from each heap's own start; keep its episodes.

        Args:
            step: Actions executed so far.
            policy: What has been learnt, or a function from an observation to an action.
            keys: Observation keys that the function reads.

        Returns:
            The mean of every metric, and its confidence interval; see `episodes.measure`.
        """
        acts = policy if isinstance(policy, Policy) else _Function(policy, tuple(keys))
        plan = EvaluationPlan(
            acts, self._heaps, self.name, self._objects, limit=self._limit, task=self._task
        )
        found = evaluate_plan(plan, self._workers)
        who = {"trained": True, "training_seed": self.seed, "training_actions": int(step)}
        save_episodes(
            self.directory / f"{self.name}.npz", Evaluation({**found.header, **who}, found.episodes)
        )
        inputs = {name: found.header[name] for name in ("heap_set", "object_set")}
        write_record(self.directory / INPUTS_FILE, "record of a run's inputs", inputs)
        scores = logged(score(found.episodes))
        self._append("held_out", step, scores)
        return scores

    def _append(self, kind: str, step: int, values: dict[str, float]) -> None:
        line = {"step": int(step), "kind": kind, **values}
        append_line(self.directory / METRICS_FILE, line)


class _Function:
    """A function from observations to actions as a policy."""

    def __init__(self, act: Callable[[Observation], Array], keys: tuple[str, ...]) -> None:
        self.act, self.keys = act, keys

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode; there is nothing to draw."""
