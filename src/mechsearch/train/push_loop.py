"""`plus`: push, see what it brought, and learn to choose pushes by how they look."""

from pathlib import Path

from mechsearch.actor_critic.collector import Parts
from mechsearch.env.heap_env import HeapEnv
from mechsearch.processes import Progress, silent
from mechsearch.push_values.session import PushSession, load_episode, save_episode
from mechsearch.train.checkpoint import RunDirectory
from mechsearch.train.config import TrainConfig
from mechsearch.train.evaluate import evaluate, label
from mechsearch.train.log import RunLog
from mechsearch.types import MechSearchError

EPISODES = "pushes"
"""Folder of a run directory with what its episodes taught."""


def learn_pushes(
    config: TrainConfig,
    parts: Parts,
    directory: Path,
    resume: bool = False,
    progress: Progress = silent,
) -> dict[str, float]:
    """Learn pushes and write the run directory; return the last evaluation.

    Networks are fitted anew, and scored, whenever another `evaluate_every` actions are executed, at
    the end of that episode. Scores are logged under the round number of actions.

    Args:
        config: The run; `pushes` says how.
        parts: Environment and evaluators; no teachers.
        directory: Where the run is written.
        resume: Go on from the last checkpoint, exactly as if nothing had happened; a finished run
            goes on to more actions as if it had been meant to from the start.
        progress: Told after each episode, with the last evaluation.

    Raises:
        MechSearchError: If the directory holds another run, or the environment has no heaps.
    """
    if not isinstance(parts.env, HeapEnv):
        raise MechSearchError(f"pushes are learnt in heaps, not in a {type(parts.env).__name__}")
    files, session = RunDirectory(directory), PushSession(config, parts.env, parts.heaps)
    checkpoint = files.open(config, resume)
    if checkpoint:
        count = int(checkpoint.meta["counts"]["episodes"])
        session.restore(checkpoint, [load_episode(_file(directory, i)) for i in range(count)])
    log, scores = RunLog(directory, checkpoint), {}
    if not checkpoint and config.held_out_heaps:
        scores = evaluate(session.policy, 0, parts.evaluators, log)
    every = config.evaluate_every
    for step in range((session.counts["fits"] + 1) * every, config.actions + 1, every):
        while session.counts["executed"] < step:
            episode = session.episode()
            save_episode(episode, _file(directory, session.counts["episodes"] - 1))
            session.remember(episode)
            log.write("episode", step, {"executed": session.counts["executed"], **episode.summary})
            progress(label(config.name, scores), session.counts["executed"], config.actions)
        log.write("fit", step, session.fit())
        scores = evaluate(session.policy, step, parts.evaluators, log)
        files.save_actor(step, session.policy)
        files.save(step, *session.archive(), log.size)
    log.close()
    return scores


def _file(directory: Path, episode: int) -> Path:
    return directory / EPISODES / f"{episode:06d}.safetensors"
