"""Progress bars with rate and time left."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Display

from mechsearch.processes.mapping import Progress


@contextmanager
def bars() -> Iterator[Progress]:
    """Show progress on the error stream while inside, once there is any; yields how to tell it.

    The first word of a label, up to a comma, names its bar; what follows may change, such as the
    last scores.
    """
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    display = Display(*columns, console=Console(stderr=True))
    tasks: dict[str, TaskID] = {}

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
