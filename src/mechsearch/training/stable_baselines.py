"""A callback with which learners of stable-baselines3 have curves among ours."""

from pathlib import Path
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback

from mechsearch.training.curve_logger import CurveLogger


class CurveCallback(BaseCallback):
    """Notes each episode, and scores the model on held-out heaps at the start, on the way, last.

    The model acts deterministically when it is scored.
    """

    def __init__(self, directory: str | Path, name: str, every: int = 1000, **options: Any) -> None:
        """Begin a run directory.

        Args:
            directory: To write.
            name: Under which the learner is reported.
            every: Actions between evaluations.
            options: Of `CurveLogger`, such as `heaps`.

        Raises:
            MechSearchError: If the directory holds a run already.
        """
        super().__init__()
        self._log, self._every, self._next = CurveLogger(directory, name, **options), every, 0

    def _on_training_start(self) -> None:
        self._look()

    def _on_step(self) -> bool:
        for info in self.locals.get("infos", ()):
            if "episode" in info:
                done = info["episode"]
                self._log.episode(self.num_timesteps, done["r"], done["l"])
        if self.num_timesteps >= self._next:
            self._look()
        return True

    def _on_training_end(self) -> None:
        if self.num_timesteps > self._next - self._every:
            self._look()

    def _look(self) -> None:
        """Score the model as it is; the next time is a whole number of intervals away."""
        step = self.num_timesteps
        space: Any = self.model.observation_space
        self._log.evaluate(step, self._act, tuple(space.spaces))
        self._next = step - step % self._every + self._every

    def _act(self, obs: Any) -> Any:
        return self.model.predict(obs, deterministic=True)[0]
