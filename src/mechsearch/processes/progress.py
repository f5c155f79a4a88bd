"""How long work is told of: not at all, or by bars with rate and time left."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol


class Progress(Protocol):
    """Shown while something long goes on."""

    def __call__(self, label: str, done: int, total: int) -> None:
        """Tell that `done` of `total` pieces of `label` are finished."""


def silent(label: str, done: int, total: int) -> None:
    """Show nothing."""


@contextmanager
def bars() -> Iterator[Progress]:
    """Show progress on the error stream while inside, once there is any; yields how to tell it.

    The first word of a label, up to a comma, names its bar; what follows may change, such as the
    last scores.
    """
    from rich import progress as rich
    from rich.console import Console

    display = rich.Progress(
        rich.TextColumn("{task.description}"),
        rich.BarColumn(),
        rich.MofNCompleteColumn(),
        rich.TextColumn("{task.fields[rate]}"),
        rich.TimeRemainingColumn(),
        console=Console(stderr=True),
    )
    tasks: dict[str, rich.TaskID] = {}

    def show(label: str, done: int, total: int) -> None:
        name = label.split(",")[0]
        if name not in tasks:
            display.start()
            # A resumed run begins in the middle: what was done before is not its rate.
            tasks[name] = display.add_task(label, total=total, completed=done, rate="")
        speed = next(task.speed for task in display.tasks if task.id == tasks[name])
        rate = f"{speed:.1f}/s" if speed else ""
        display.update(tasks[name], completed=done, total=total, description=label, rate=rate)

    try:
        yield show
    finally:
        if tasks:
            display.stop()
