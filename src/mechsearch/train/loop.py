"""The training loop: act, remember, improve; the world turns while the networks learn."""

from pathlib import Path

from mechsearch.actor_critic.background import background
from mechsearch.actor_critic.collector import Parts
from mechsearch.actor_critic.policy import ActorPolicy
from mechsearch.actor_critic.session import Session
from mechsearch.processes import Progress, silent
from mechsearch.train.checkpoint import RunDirectory
from mechsearch.train.config import TrainConfig
from mechsearch.train.evaluate import evaluate, label
from mechsearch.train.log import RunLog
from mechsearch.train.speed import Speed


def train(
    config: TrainConfig,
    parts: Parts,
    directory: Path,
    resume: bool = False,
    progress: Progress = silent,
) -> dict[str, float]:
    """Train an actor and write the run directory; return the last evaluation.

    While some actions are executed by copies of actor and critic, the updates that are due for all
    actions before them are taken: who finishes first changes nothing.

    Args:
        config: The run.
        parts: Environment, teachers and evaluators.
        directory: Where the run is written.
        resume: Go on from the last checkpoint, exactly as if nothing had happened; a finished run
            goes on to more actions as if it had been meant to from the start.
        progress: Told after each action, with the last evaluation.

    Raises:
        MechSearchError: If the directory holds another run, or a part does not fit.
    """
    run, session = RunDirectory(directory), Session(config, parts)
    checkpoint = run.open(config, resume)
    if checkpoint:
        session.restore(checkpoint)
    log, speed = RunLog(directory, checkpoint), Speed(session.step, session.counts["updates"])
    scores: dict[str, float] = {}

    def look() -> dict[str, float]:
        session.update()
        log.write_speed(session.step, speed.lap(session.step, session.counts["updates"]))
        policy = ActorPolicy(session.learner.actor_target, session.step)
        run.save_actor(session.step, policy)
        return evaluate(policy, session.step, parts.evaluators, log)

    if session.step == 0 and config.held_out_heaps:
        scores = evaluate(ActorPolicy(session.learner.actor_target), 0, parts.evaluators, log)
    with background() as thread:
        while session.step < config.actions:
            begins = session.begins_block
            if begins:
                session.behaviour.refresh()
            actions = thread.submit(session.collector.collect, session.next_actions())
            if begins:
                with speed.updating():
                    session.update()
            for transition in actions.result():
                summary = session.store(transition)
                if summary is not None:
                    log.write("episode", session.step, summary)
                progress(label(config.name, scores), session.step, config.actions)
            if session.step % config.evaluate_every == 0:
                scores = look()
            if session.step % config.checkpoint_every == 0 or session.step == config.actions:
                run.save(session.step, *session.archive(), log.size)
    # After the checkpoint: a run that is made longer later does not look here.
    if session.step % config.evaluate_every:
        scores = look()
    log.close()
    return scores
