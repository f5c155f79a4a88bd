"""File names of run directories and sweeps that several rooms know, and the user's cache folder."""

import os
from pathlib import Path

from platformdirs import user_cache_dir

CONFIG_FILE = "config.json"
"""What a run is: its task, its algorithm and its schedule."""

INPUTS_FILE = "inputs.json"
"""What a run was made from, beside its configuration, so that it can go on by itself."""

METRICS_FILE = "metrics.jsonl"
"""What the seed decides of a run, a record a line."""

SPEED_FILE = "speed.jsonl"
"""What depends on the machine, likewise."""

PROGRESS_FILE = "progress.json"
"""How far a run is, for those who watch it; it depends on the machine, too."""

EVENTS_FOLDER = "tensorboard"
CHECKPOINTS_FOLDER = "checkpoints"
POLICIES_FOLDER = "actors"

POLICY_FILE = "actor.safetensors"
"""The last policy of a run."""

CHECKPOINT_FILE = "checkpoint.safetensors"
"""How far a training of a network for grasps or images is, to go on from."""

NETWORK_FILE = "network.safetensors"
"""What a training of a network for grasps or images writes at its end."""

FINISHED_FILE = "finished.json"
"""Written last into the directory of a run that is over."""

PLAN_FILE = "sweep.json"
JOURNAL_FILE = "jobs.jsonl"
SUMMARY_FILE = "summary.csv"
CURVES_FILE = "curves.csv"
RUNS_FOLDER = "runs"
EVALUATIONS_FOLDER = "evaluations"

SCORES_SUFFIX = ".scores.npz"
"""Ends the name of the compact scores beside episodes: those of `a.npz` are in `a.scores.npz`."""


def cache_folder() -> Path:
    """Return the user's cache folder, or the one that MECHSEARCH_CACHE names."""
    return Path(os.environ.get("MECHSEARCH_CACHE") or user_cache_dir("mechsearch"))
