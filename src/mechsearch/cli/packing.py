"""`mechsearch pack`."""

import hashlib
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import tyro

from mechsearch.cli.command import Command, wrote
from mechsearch.evaluation.episodes import Evaluation, load_episodes, summary_rows
from mechsearch.evaluation.policies import actor_of
from mechsearch.files import (
    CONFIG_FILE,
    INPUTS_FILE,
    METRICS_FILE,
    read_lines,
    read_record,
    write_json,
)
from mechsearch.training.run_directory import load_policy, save_policy
from mechsearch.types import MechSearchError


@dataclass(frozen=True)
class Pack(Command):
    """Pack a run's policy for others: its weights, and a card of its data, settings and scores.

    Weights are rounded to 16 bits.

    Attributes:
        run_directory: What `mechsearch train` wrote.
        scores: What `mechsearch evaluate` recorded of it (.npz).
        out: Weights to write (.safetensors); the card comes beside them (.json).
    """

    writes = (("out", (".safetensors",)),)

    run_directory: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    scores: Path
    out: Path

    def run(self) -> None:
        """Write both files."""
        policy = load_policy(self.run_directory)
        card = self._card(load_episodes(self.scores), policy.training_actions)
        save_policy(policy, self.out, rounded=True)
        weights = hashlib.sha256(self.out.read_bytes()).hexdigest()
        write_json(self.out.with_suffix(".json"), {"sha256": weights, **card})
        wrote(self.out)

    def _card(self, evaluation: Evaluation, actions: int) -> dict[str, Any]:
        config = read_record(self.run_directory / CONFIG_FILE, "training configuration")
        inputs = read_record(self.run_directory / INPUTS_FILE, "record of a run's inputs")
        header = evaluation.header
        actor = actor_of(str(self.run_directory))
        own = {"actor": actor, "training_seed": config["seed"], "training_actions": actions}
        if any(header.get(name) != value for name, value in own.items()):
            raise MechSearchError(
                f"{self.scores} are of another policy than {self.run_directory}: of "
                f"{header['name']!r} after {header['training_actions']} actions, training seed "
                f"{header['training_seed']}; score this one by `mechsearch evaluate`"
            )
        lines = read_lines(self.run_directory / METRICS_FILE)
        simulated = max((int(line.get("simulated", 0)) for line in lines), default=0)
        return {
            "version": version("mechsearch"),
            "variant": config["name"],
            "seed": config["seed"],
            "trained_on": {"heap_set": inputs["heap_set"], "condition": header["condition"]},
            "executed_actions": actions,
            "simulated_actions": simulated,
            "config": config,
            "scored_on": {name: header[name] for name in ("heap_set", "split", "heaps", "seed")},
            "scores": {
                row.metric: [row.mean, row.ci_low, row.ci_high]
                for row in summary_rows("card", evaluation)
            },
        }
