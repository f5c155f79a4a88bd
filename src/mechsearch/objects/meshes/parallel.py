"""Prepare the objects that no cache holds yet, in parallel, with a progress bar."""

import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from mechsearch.objects.meshes.cache import cache_path, cached, prepare_into
from mechsearch.objects.meshes.limits import FLAGGED_ERROR
from mechsearch.objects.meshes.prepare import Prepared, Source
from mechsearch.types import MechSearchError


def prepare_all(sources: Sequence[Source], workers: int | None = None) -> list[Prepared]:
    """Return every object prepared, from the cache where it holds it.

    Objects whose convex parts are more than 5 mm from their mesh are named after preparation.

    Args:
        sources: What to prepare.
        workers: Most processes; as many as there are processors by default.

    Raises:
        MechSearchError: If objects cannot be prepared; names every one of them.
    """
    paths = [cache_path(source) for source in sources]
    found = {path: cached(path) for path in paths}
    todo = {
        path: source for source, path in zip(sources, paths, strict=True) if found[path] is None
    }
    if todo:
        console = Console(stderr=True)
        _prepare_missing(todo, min(workers or os.cpu_count() or 1, len(todo)), console)
        found |= {path: cached(path) for path in todo}
        _flag([found[path] for path in todo], console)
    done = [found[path] for path in paths]
    lost = [source.name for source, model in zip(sources, done, strict=True) if model is None]
    if lost:
        raise MechSearchError(f"cannot keep {', '.join(lost)} in the cache at {paths[0].parent}")
    return [model for model in done if model is not None]


def _prepare_missing(todo: Mapping[Path, Source], workers: int, console: Console) -> None:
    failures = []
    with Progress(
        TextColumn("preparing objects"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.description}"),
        console=console,
    ) as progress:
        bar = progress.add_task("", total=len(todo))
        for source, outcome in _outcomes(todo, workers):
            progress.update(bar, advance=1, description=source.name)
            if isinstance(outcome, MechSearchError):
                failures.append(str(outcome))
            elif outcome:
                warnings.warn(f"{source.name} keeps one hull: {outcome}", stacklevel=3)
    if failures:
        raise MechSearchError("; ".join(sorted(failures)))


def _flag(prepared: Sequence[Prepared | None], console: Console) -> None:
    coarse = [
        f"{done.model.name} {1000 * done.model.hull_error:.0f} mm"
        for done in prepared
        if done and not done.excluded and done.model.hull_error > FLAGGED_ERROR
    ]
    if coarse:
        limit = 1000 * FLAGGED_ERROR
        console.print(f"convex parts more than {limit:.0f} mm from the mesh: {', '.join(coarse)}")


def _outcomes(
    todo: Mapping[Path, Source], workers: int
) -> Iterator[tuple[Source, str | MechSearchError]]:
    """Yield each source as it is done, with the remark of its preparation or its failure."""
    left = dict(todo)
    if workers > 1:
        pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
        jobs = {pool.submit(prepare_into, source, path): path for path, source in todo.items()}
        try:
            for job in as_completed(jobs):
                outcome = _outcome(job.result)
                yield left.pop(jobs[job]), outcome
        except BrokenProcessPool:
            pass  # A script without a main guard, or too little memory: go on in this process.
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
    for path, source in left.items():
        yield source, _outcome(partial(prepare_into, source, path))


def _outcome(prepare: Callable[[], str]) -> str | MechSearchError:
    try:
        return prepare()
    except MechSearchError as error:
        return error
