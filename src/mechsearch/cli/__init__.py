"""The command line: parsing and calls, nothing else.

Each command is a function in a module of this package, which is imported when the command is
called: help is quick, and only `train` and trained policies need PyTorch.
"""

import importlib
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import tyro

from mechsearch.types import MechSearchError

COMMANDS = {
    "assets pull": ("assets:pull", "download an object set from its official site"),
    "objects list": ("objects:list_objects", "list the objects of a set, and those left out"),
    "objects sheet": ("objects:sheet", "draw every object of a set on one picture"),
    "heaps generate": ("heaps:generate", "drop objects into heaps and keep the useful ones"),
    "heaps show": ("heaps:show", "say what is in a heap set, and draw it"),
    "heaps verify": ("heaps:verify", "restore every heap; prove its rest and its occlusion"),
    "demonstrate": ("training:demonstrate", "record a look-ahead expert on the training heaps"),
    "train": ("training:train", "train an actor: method, ddpg, plus or an ablation"),
    "evaluate": ("evaluation:evaluate", "score policies on a heap set and record the episodes"),
    "show": ("evaluation:show", "draw a recorded episode as picture, filmstrip, GIF or MP4"),
    "report": ("reporting:report", "write one HTML page, or the plot of a summary"),
    "demo": ("demo:demo", "the whole way: heaps, training, evaluation, report"),
}
"""Every command, where it is, and what it does."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command; exit with 2 after bad input, having said in one line what was wrong."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        _dispatch(words)
    except MechSearchError as error:
        print(f"mechsearch: {' '.join(str(error).split())}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        print("mechsearch: interrupted; files already written are whole", file=sys.stderr)
        raise SystemExit(130) from None


def _dispatch(words: list[str]) -> None:
    if words in (["--version"], ["-V"]):
        print(f"mechsearch {version('mechsearch')}")
        return
    for length in (2, 1):
        name = " ".join(words[:length])
        if name in COMMANDS and len(words) >= length:
            _call(name, words[length:])
            return
    if not words or words[0] in ("-h", "--help", "help"):
        print(usage())
        return
    group = {name: entry for name, entry in COMMANDS.items() if name.startswith(f"{words[0]} ")}
    if group and words[1:] in ([], ["-h"], ["--help"]):
        print(usage(group))
        return
    raise MechSearchError(
        f"unknown command {' '.join(words[: 2 if group else 1])!r}; choose one of "
        f"{', '.join(group or COMMANDS)}"
    )


def _call(name: str, words: list[str]) -> None:
    module, _, function = COMMANDS[name][0].partition(":")
    command: Callable[..., Any] = getattr(
        importlib.import_module(f"mechsearch.cli.{module}"), function
    )
    # Users' own policies are looked for where they stand, after everything that is installed.
    sys.path.append(str(Path.cwd()))
    if hasattr(command, "from_words"):
        command.from_words(words)
    else:
        tyro.cli(command, prog=f"mechsearch {name}", args=words)


def usage(commands: dict[str, tuple[str, str]] | None = None) -> str:
    """Return the list of commands."""
    shown = commands or COMMANDS
    width = max(map(len, shown))
    lines = [f"  {name.ljust(width)}  {purpose}" for name, (_, purpose) in shown.items()]
    head = "Teach robots to uncover a known object in a heap of unknown ones."
    tail = "mechsearch COMMAND --help tells its options; mechsearch --version the version."
    return "\n".join([head, "", "Commands:", *lines, "", tail])
