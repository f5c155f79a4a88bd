"""The command line: parsing and calls, nothing else.

Each command is a class in a module of this package, which is imported when the command is called:
help is quick, and only `train`, `grasp`, `demo` and trained policies need PyTorch.
"""

import importlib
import importlib.util
import os
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from mechsearch.files import REFUSALS, not_written
from mechsearch.types import MechSearchError


class Entry(NamedTuple):
    """Where a command is, what it does, and whether it needs PyTorch."""

    place: str
    purpose: str
    learns: bool = False


COMMANDS = {
    "assets pull": Entry("objects:Pull", "download an object set from its official site"),
    "objects list": Entry("objects:List", "list the objects of a set, and those left out"),
    "objects sheet": Entry("objects:Sheet", "draw every object of a set on one picture"),
    "heaps generate": Entry("heaps:Generate", "drop objects into heaps, and keep the useful ones"),
    "heaps show": Entry("heaps:ShowHeaps", "say what is in a heap set, and draw it"),
    "heaps verify": Entry("heaps:VerifyHeaps", "prove that every heap rests, hidden as recorded"),
    "train": Entry("training:Train", "train an actor, or go on with a run", learns=True),
    "evaluate": Entry("evaluation:Evaluate", "score policies on heaps and record the episodes"),
    "sweep": Entry("sweeping:Sweep", "every experiment of the paper, by one command", learns=True),
    "verify": Entry("verification:Verify", "play recorded episodes again: the same bits?"),
    "show": Entry(
        "evaluation:ShowEpisode", "draw a recorded episode: picture, filmstrip, GIF or MP4"
    ),
    "pack": Entry("packing:Pack", "a run's policy for others, with a card", learns=True),
    "grasp score": Entry(
        "grasping:ScoreGrasps", "rate grasps on targets: heaps, or your image", True
    ),
    "grasp lift": Entry(
        "grasping:LiftGrasps", "try the best grasps: can the target be lifted?", True
    ),
    "grasp label": Entry(
        "grasp_learning:LabelGrasps", "try grasps on heaps: a set to learn from", True
    ),
    "grasp train": Entry("grasp_learning:TrainGrasps", "train a grasp network, or go on", True),
    "grasp test": Entry(
        "grasp_learning:TestGrasps", "judge grasp networks on labelled grasps", True
    ),
    "grasp calibrate": Entry(
        "grasp_learning:CalibrateGrasps", "hold scores against lift success", True
    ),
    "report": Entry("reporting:Report", "write one HTML page, or the plot of a summary"),
    "demo": Entry("demo:Demo", "the whole way: heaps, training, scores, report", learns=True),
}
"""Every command by its words."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command; after bad input say in one line what was wrong, and exit with 2."""
    words = list(sys.argv[1:] if arguments is None else arguments)
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
    except KeyboardInterrupt:
        print("mechsearch: interrupted; files already written are whole", file=sys.stderr)
        raise SystemExit(130) from None


def _dispatch(words: list[str]) -> None:
    for length in (2, 1):
        name = " ".join(words[:length])
        if name in COMMANDS:
            _call(name, words[length:])
            return
    group = {name: e for name, e in COMMANDS.items() if words and name.startswith(f"{words[0]} ")}
    rest = words[1:] if group else words
    if rest in (["--version"], ["-V"]):
        print(f"mechsearch {version('mechsearch')}")
    elif rest in ([], ["-h"], ["--help"], ["help"]):
        print(usage(group or COMMANDS))
    else:
        raise MechSearchError(
            f"unknown command {' '.join(words[: 2 if group else 1])!r}; "
            f"choose one of {', '.join(group or COMMANDS)}"
        )


def _call(name: str, words: list[str]) -> None:
    entry = COMMANDS[name]
    if entry.learns and importlib.util.find_spec("torch") is None:
        raise MechSearchError(f"`mechsearch {name}` needs PyTorch: install mechsearch[learn]")
    module, _, command = entry.place.partition(":")
    # Users' own policies are looked for where they stand, after everything that is installed.
    sys.path.append(str(Path.cwd()))
    kind = getattr(importlib.import_module(f"mechsearch.cli.{module}"), command)
    kind.parse(f"mechsearch {name}", words).run()


def usage(commands: Mapping[str, Entry]) -> str:
    """Return a list of commands, one a line."""
    width = max(map(len, commands))
    lines = [f"  {name.ljust(width)}  {entry.purpose}" for name, entry in commands.items()]
    head = "Teach robots to uncover a known object in a heap of unknown ones."
    tail = (
        "`mechsearch COMMAND --help` tells a command's options, `mechsearch --version` the version."
    )
    return "\n".join([head, "", *lines, "", tail])
