"""The training loop: act, remember, improve."""

from pathlib import Path

from mechsearch.agent.policy import ActorPolicy
from mechsearch.parallel import Progress, silent
from mechsearch.train.checkpoint import RunDirectory
from mechsearch.train.config import TrainConfig
from mechsearch.train.evaluate import evaluate, label
from mechsearch.train.log import RunLog
from mechsearch.train.session import Parts, Session
from mechsearch.train.speed import Speed


def train(
    config: TrainConfig,
    parts: Parts,
    directory: Path,
    resume: bool = False,
    progress: Progress = silent,
) -> dict[str, float]:
    """Train an actor and write the run directory; return the last evaluation.

    Args:
        config: The run.
        parts: Environment, teachers and evaluators.
        directory: Where the run is written.
        resume: Go on from the last checkpoint, exactly as if nothing had happened.
        progress: Told after each action, with the last evaluation.

    Raises:
        MechSearchError: If the directory holds another run, or a part does not fit.
    """
    run, session = RunDirectory(directory), Session(config, parts)
    checkpoint = run.open(config, resume)
    if checkpoint:
        session.restore(checkpoint)
    log, speed = RunLog(directory, session.step), Speed(session.step, session.counts["updates"])
    scores: dict[str, float] = {}
    last_saved, obs = session.step, session.begin()
    while session.step < config.actions:
        decision = session.decide(obs)
        outcome = parts.env.step(decision.action)
        session.store(obs, decision, outcome)
        obs, _, terminated, truncated, info = outcome
        with speed.updating():
            session.update()
        if terminated or truncated:
            log.write("episode", session.step, session.episode.summary(terminated, info))
        if session.step % config.evaluate_every == 0 or session.step == config.actions:
            log.write_speed(session.step, speed.lap(session.step, session.counts["updates"]))
            policy = ActorPolicy(session.learner.actor, session.step)
            scores = evaluate(policy, session.step, parts.evaluators, log)
            run.save_actor(session.step, policy)
        if terminated or truncated:
            if session.step - last_saved >= config.checkpoint_every:
                run.save(session.step, *session.archive())
                last_saved = session.step
            obs = session.begin()
        progress(label(config.name, scores), session.step, config.actions)
    log.close()
    return scores
