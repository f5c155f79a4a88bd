"""Progress bars with rate and time left."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bars

from mechsearch.processes import Progress


@contextmanager
def progress_bars(console: Console | None = None) -> Iterator[Progress]:
    """Show a bar while inside; yields what to call after each piece.

    The first word of a label names its bar; what follows may change, such as the last scores.
    """
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Bars(*columns, console=console) as bars:
        tasks: dict[str, TaskID] = {}

        def show(label: str, done: int, total: int) -> None:
            name = label.split(",")[0]
            if name not in tasks:
                # A resumed run begins in the middle: what was done before is not its rate.
                tasks[name] = bars.add_task(label, total=total, completed=done, rate="")
            speed = next(task.speed for task in bars.tasks if task.id == tasks[name])
            rate = f"{speed:.1f}/s" if speed else ""
            bars.update(tasks[name], completed=done, total=total, description=label, rate=rate)

        yield show
