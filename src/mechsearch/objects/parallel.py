"""Prepare the objects that no cache holds yet, in parallel, with a progress bar."""

import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
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

from mechsearch.objects.cache import cache_path, cached, prepare_into
from mechsearch.objects.prepare import Prepared, Source
from mechsearch.types import MechSearchError


def prepare_all(sources: Sequence[Source], workers: int | None = None) -> list[Prepared]:
    """Return every object prepared, from the cache where it holds it.

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
        _prepare_missing(todo, min(workers or os.cpu_count() or 1, len(todo)))
        found |= {path: cached(path) for path in todo}
    done = [found[path] for path in paths]
    lost = [source.name for source, model in zip(sources, done, strict=True) if model is None]
    if lost:
        raise MechSearchError(f"cannot keep {', '.join(lost)} in the cache at {paths[0].parent}")
    return [model for model in done if model is not None]


def _prepare_missing(todo: Mapping[Path, Source], workers: int) -> None:
    failures = []
    console = Console(stderr=True)
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
        for source, failure in _outcomes(todo, workers):
            progress.update(bar, advance=1, description=source.name)
            if failure:
                failures.append(failure)
    if failures:
        raise MechSearchError("; ".join(sorted(failures)))


def _outcomes(todo: Mapping[Path, Source], workers: int) -> Iterator[tuple[Source, str]]:
    """Yield each source as it is done, with the message of its failure or an empty string."""
    left = dict(todo)
    if workers > 1:
        pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
        jobs = {pool.submit(prepare_into, source, path): path for path, source in todo.items()}
        try:
            for job in as_completed(jobs):
                failure = _failure(job)
                yield left.pop(jobs[job]), failure
        except BrokenProcessPool:
            pass  # A script without a main guard, or too little memory: go on in this process.
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
    for path, source in left.items():
        try:
            prepare_into(source, path)
            yield source, ""
        except MechSearchError as error:
            yield source, str(error)


def _failure(job: Future[None]) -> str:
    try:
        job.result()
    except MechSearchError as error:
        return str(error)
    return ""
