"""The training loop: advance, note, look, keep; every algorithm's runs go through it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mechsearch.algorithm import RunConfig, Session, TrainingSetup
from mechsearch.processes import Progress, silent
from mechsearch.training.log import RunLog
from mechsearch.training.run_directory import RunDirectory, trained


def learn(
    config: RunConfig[Any],
    setup: TrainingSetup,
    directory: Path,
    resume: bool = False,
    progress: Progress = silent,
) -> dict[str, float]:
    """Learn, and write the run directory; return the last evaluation.

    Args:
        config: The run.
        setup: Environment, heaps, teachers and evaluators.
        directory: Where the run is written.
        resume: Go on from the last checkpoint, exactly as if nothing had happened; a finished run
            goes on to more actions as if it had been meant to from the start.
        progress: Told after each action, or episode of pushes, with the last evaluation.

    Raises:
        MechSearchError: If the directory holds another run, or a part does not fit.
    """
    schedule, files = config.schedule, RunDirectory(directory)
    session: Session = config.algorithm.begin(config, setup, directory)
    checkpoint = files.open(config, resume)
    begun = int(checkpoint.meta["step"]) if checkpoint else 0
    if checkpoint:
        session.restore(checkpoint.tensors, checkpoint.meta)
    log, scores = RunLog(directory, checkpoint), dict[str, float]()

    def tell(doing: str = "") -> None:
        label = _label(config.name, scores)
        named = f"{label}, {doing}" if doing else label
        progress(named, session.executed, schedule.actions)

    def look(step: int) -> dict[str, float]:
        tell("learning")
        for line in session.catch_up(step):
            log.write(*line)
        policy = trained(session.policy, config.algorithm, session.executed, config.task)
        files.save_policy(step, policy)
        return _evaluate(policy, step)

    def _evaluate(policy: Any, step: int) -> dict[str, float]:
        tell("scoring")
        found = {name: dict(score(policy)) for name, score in setup.evaluators.items()}
        for name, values in found.items():
            log.write(name, step, values)
        return next(iter(found.values()), {})

    if not begun and schedule.held_out_heaps:
        scores = _evaluate(session.policy, 0)
    for stop in schedule.stops(begun):
        while session.executed < stop:
            for lines in session.advance(stop):
                for line in lines:
                    log.write(*line)
                tell()
        if stop % schedule.evaluate_every == 0:
            scores = look(stop)
        if stop % schedule.checkpoint_every == 0 or stop == schedule.actions:
            files.save(stop, *session.archive(), log.size)
    # After the checkpoint: a run that is made longer later does not look here.
    if schedule.actions % schedule.evaluate_every:
        scores = look(schedule.actions)
    tell()
    log.close()
    return scores


def _label(name: str, scores: Mapping[str, float]) -> str:
    """Return what a progress bar shows: the run and its last evaluation."""
    shown = {"reward": "reward {:.1f}", "uncovered_rate": "uncovered {:.0%}"}
    return ", ".join((name, *(t.format(scores[k]) for k, t in shown.items() if k in scores)))
