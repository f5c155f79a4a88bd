"""The command line: parsing and calls, nothing else.

Each command is a class in a module of this package, which is imported when the command is called:
help is quick, and optional parts of an installation are needed by those alone that use them.
"""

import importlib
import io
import os
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from mechsearch.files import REFUSALS, not_written
from mechsearch.types import MechSearchError, check_extra

COMMANDS = {
    "assets pull": ("objects:Pull", "download an object set from its official site"),
    "objects list": ("objects:List", "list the objects of a set, and those left out"),
    "objects sheet": ("objects:Sheet", "draw every object of a set on one picture"),
    "heaps generate": ("heaps:Generate", "drop objects into heaps, and keep the useful ones"),
    "heaps join": ("heaps:JoinHeaps", "one heap set of several"),
    "heaps show": ("heaps:ShowHeaps", "say what is in a heap set, and draw it"),
    "heaps verify": ("heaps:VerifyHeaps", "prove that every heap rests, hidden as recorded"),
    "train": ("training:Train", "train an actor, or go on with a run"),
    "evaluate": ("evaluation:Evaluate", "score policies on heaps and record the episodes"),
    "status": ("status:Status", "how far runs and sweeps are, at work or not"),
    "sweep": ("sweeping:Sweep", "every experiment of the paper, by one command"),
    "verify": ("evaluation:Verify", "play recorded episodes again: the same bits?"),
    "show": ("evaluation:ShowEpisode", "draw a recorded episode: picture, film, or a page in 3-D"),
    "view": ("viewing:ViewLive", "a live page: watch a policy, push by hand, keep the episode"),
    "export episodes": ("export_episodes:ExportEpisodes", "episodes for LeRobot, Minari"),
    "export policy": ("export_policy:ExportPolicy", "a policy for a robot's computer"),
    "export segmenter": ("export_segmenter:ExportSegmenter", "masks of one object, likewise"),
    "export grasps": ("export_grasps:ExportGrasps", "grasps of one gripper, likewise"),
    "pack": ("packing:Pack", "a run's policy for others, with a card"),
    "robot play": ("robot:PlayBag", "what a policy would do on a recorded bag; nothing moves"),
    "robot calibrate": ("calibrating:Calibrate", "where a camera is, from images of a board"),
    "robot check-calibration": (
        "calibrating:CheckCalibration",
        "does a calibration hold? points that the robot touched",
    ),
    "grasp score": ("grasping:ScoreGrasps", "rate grasps on targets: heaps, or your image"),
    "grasp lift": ("grasping:LiftGrasps", "try the best grasps: can the target be lifted?"),
    "grasp label": ("grasp_learning:LabelGrasps", "try grasps on heaps: a set to learn from"),
    "grasp train": ("grasp_learning:TrainGrasps", "train a grasp network, or go on"),
    "grasp test": ("grasp_learning:TestGrasps", "judge grasp networks on labelled grasps"),
    "grasp calibrate": ("grasp_learning:CalibrateGrasps", "hold scores against lift success"),
    "grasp ceiling": ("grasping:FindCeiling", "which targets can grippers lift at all?"),
    "segment images": ("segmentation:MakeImages", "render heaps for training a segmentation"),
    "segment train": ("segmentation:TrainSegmentation", "train a segmentation, or go on"),
    "segment occlusion": ("segmentation:TrainOcclusion", "train an estimate of what is hidden"),
    "segment reference": ("segmentation:MakeReference", "views of an object by photographs"),
    "segment test": ("segmentation:TestSegmentation", "hold masks against the truth on heaps"),
    "segment show": ("segmentation:ShowSegmentation", "draw images, truth and masks"),
    "benchmark list": ("benchmark:ListSplits", "the benchmark's tasks, splits and heaps"),
    "benchmark run": ("benchmark:RunBenchmark", "a policy's episodes and card, as a submission"),
    "benchmark submit": ("benchmark:Submit", "play a submission again, and enter it"),
    "benchmark table": ("benchmark:TabulateSubmissions", "the table of all submissions"),
    "report": ("reporting:Report", "write one HTML page, or the plot of a summary"),
    "demo": ("demo:Demo", "the whole way: heaps, training, scores, report"),
    "doctor": ("doctor:Doctor", "say what works here, what is missing, how to get it"),
}
"""Where every command is, by its words, and what it does."""

GRIPPER_COMMANDS = {
    "grasp lift": "grasping:LiftChosen",
    "grasp label": "grasp_learning:LabelTrials",
    "grasp train": "grasp_learning:TrainQuality",
    "grasp test": "grasp_learning:TestQuality",
}
"""Where those commands are that, with `--gripper`, are about the networks of that gripper; without
it, about the paper's graspability."""

_NEEDED = {
    "learn": (
        "train",
        "sweep",
        "pack",
        "export policy",
        "export segmenter",
        "export grasps",
        "grasp",
        "segment",
        "demo",
    ),
    "report": ("report", "demo"),
}
EXTRAS_OF = {
    name: [extra for extra, groups in _NEEDED.items() if {name, name.split()[0]} & set(groups)]
    for name in COMMANDS
}
"""The optional parts of an installation without which a command cannot be."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command; after bad input say in one line what was wrong, and exit with 2."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    # What is drawn is drawn into files, whatever a notebook has set.
    os.environ["MPLBACKEND"] = "agg"
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A name that the terminal cannot show is no reason to stop.
            stream.reconfigure(errors="backslashreplace")
    try:
        _dispatch(words)
    except MechSearchError as error:
        print(f"mechsearch: {' '.join(str(error).split())}", file=sys.stderr)
        raise SystemExit(2) from None
    except BrokenPipeError:
        # Whoever read the output has had enough; what Python still holds must not be written.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(1) from None
    except OSError as error:
        # Where a library writes by itself; other errors of the system are ours.
        if error.errno not in REFUSALS:
            raise
        said = not_written(error, Path(str(error.filename or "a file")))
        print(f"mechsearch: {said}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt as stop:
        print(f"mechsearch: interrupted{f'; {stop}' if str(stop) else ''}", file=sys.stderr)
        raise SystemExit(130) from None


def _dispatch(words: list[str]) -> None:
    # A robot's installation has few of them.
    own = {file.stem for file in Path(__file__).parent.glob("*.py")}
    here = {name: c for name, c in COMMANDS.items() if c[0].partition(":")[0] in own}
    for length in (2, 1):
        name = " ".join(words[:length])
        if name in here:
            _call(name, words[length:])
            return
    group = {name: c for name, c in here.items() if words and name.startswith(f"{words[0]} ")}
    rest = words[1:] if group else words
    if rest in (["--version"], ["-V"]):
        print(f"mechsearch {version('mechsearch')}")
    elif rest in ([], ["-h"], ["--help"], ["help"]):
        print(usage(group or here))
    else:
        raise MechSearchError(
            f"unknown command {' '.join(words[: 2 if group else 1])!r}; "
            f"choose one of {', '.join(group or here)}"
        )


def _call(name: str, words: list[str]) -> None:
    for extra in EXTRAS_OF[name]:
        check_extra(f"`mechsearch {name}`", extra)
    of_gripper = any(word.partition("=")[0] == "--gripper" for word in words)
    place = GRIPPER_COMMANDS.get(name) if of_gripper else None
    module, _, command = (place or COMMANDS[name][0]).partition(":")
    # Users' own policies are looked for where they stand, after everything that is installed.
    sys.path.append(str(Path.cwd()))
    try:
        kind = getattr(importlib.import_module(f"mechsearch.cli.{module}"), command)
    except ImportError as error:
        raise MechSearchError(
            f"`mechsearch {name}` cannot start: {error}; `mechsearch doctor` says what is missing"
        ) from error
    options: Any = kind.parse(f"mechsearch {name}", words)
    options.check_places()
    try:
        options.run()
    except KeyboardInterrupt as stop:
        left = str(stop) or options.interrupted([*name.split(), *words])
        raise KeyboardInterrupt(left) from None


def usage(commands: Mapping[str, tuple[str, str]]) -> str:
    """Return a list of commands, one a line."""
    width = max(map(len, commands))
    lines = [f"  {name.ljust(width)}  {purpose}" for name, (_, purpose) in commands.items()]
    head = "Teach robots to uncover a known object in a heap of unknown ones."
    tail = (
        "`mechsearch COMMAND --help` tells a command's options, `mechsearch --version` the version."
    )
    if two_ways := ", ".join(name for name in GRIPPER_COMMANDS if name in commands):
        tail += f"\nWith `--gripper NAME`, {two_ways} use that gripper's networks."
    return "\n".join([head, "", *lines, "", tail])
