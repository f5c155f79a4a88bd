"""Many runs from a list, none of which stops the others."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from mechsearch.processes import (
    Failure,
    Mapper,
    Progress,
    map_in_order,
    silent,
)

Config = TypeVar("Config")
Summary = TypeVar("Summary")


def run_all(
    run: Callable[[Config], Summary],
    configs: Sequence[Config],
    workers: int = 1,
    progress: Progress = silent,
    mapper: Mapper = map_in_order,
    time_limit: float | None = None,
) -> list[Summary | Failure]:
    """Return what each run gives, in the order of the configurations.

    A run whose worker dies is called again with the same configuration, so it should go on from its
    own checkpoint, and return at once if it is done: then calling this again continues a sweep.

    Args:
        run: Carries out one configuration; must pickle.
        configs: What to run.
        workers: Runs at the same time.
        progress: Told after each run.
        mapper: How the runs are spread: `map_in_order`, or `ray_map` over machines.
        time_limit: Time that one run may take [s].

    Returns:
        Summaries, and the `Failure` of each run that failed twice.

    Raises:
        MechSearchError: If a run refuses its configuration.
    """
    results: list[Summary | Failure] = []
    work: Callable[[Config], Summary | Failure] = run
    for result in mapper(work, configs, workers, time_limit, _failure, 1):
        results.append(result)
        progress("runs", len(results), len(configs))
    return results


def _failure(config: object, failure: Failure) -> Failure:
    return failure
