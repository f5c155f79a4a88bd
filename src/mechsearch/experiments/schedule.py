"""The jobs of a plan, and in which order they are carried out."""

import fnmatch
from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import product

from mechsearch.experiments.folder import SweepFolder
from mechsearch.experiments.jobs import GraspAssessor, HeapGeneration, Job, Scoring, Training
from mechsearch.experiments.plan import SweepPlan
from mechsearch.types import MechSearchError

Chain = tuple[Job, ...]
"""Jobs that are carried out one after another by the same worker."""


def chains_of(
    plan: SweepPlan, folder: SweepFolder, grasp: GraspAssessor | None = None
) -> list[Chain]:
    """Return all jobs of a plan, a run and its evaluation in one chain.

    What others need comes first. Runs come seed by seed, so that a sweep that is cut off has
    compared all variants on some seeds, rather than some variants on all seeds.
    """
    chains: list[Chain] = [
        (HeapGeneration(plan, folder, condition),)
        for condition in plan.conditions
        if not plan.heap_file(condition)
    ]
    for condition, policy in product(plan.conditions, plan.references):
        chains.append((Scoring(plan, folder, condition, policy, grasp),))
    for seed, variant, condition in product(plan.seeds, plan.variants, plan.conditions):
        run = Training(plan, folder, condition, variant, seed)
        chains.append((run, Scoring(plan, folder, condition, run, grasp)))
    return chains


def chosen(chains: Sequence[Chain], only: Sequence[str]) -> list[Chain]:
    """Return the chains with those of their jobs alone that are wanted, if need be again.

    Args:
        chains: All, in their order.
        only: Patterns of names, such as "single/method-seed*"; none wants all.

    Raises:
        MechSearchError: If a pattern is no job's.
    """
    if not only:
        return list(chains)
    names = [job.name for chain in chains for job in chain]
    wanted: set[str] = set()
    for pattern in only:
        found = fnmatch.filter(names, pattern)
        if not found:
            raise MechSearchError(
                f"no job of this sweep is called {pattern!r}; there are {len(names)}, from "
                f"{names[0]!r} to {names[-1]!r}"
            )
        wanted |= set(found)
    kept = (
        tuple(replace(job, again=True) for job in chain if job.name in wanted) for chain in chains
    )
    return [chain for chain in kept if chain]


def next_wave(chains: Sequence[Chain], done: Collection[str], tried: set[Chain]) -> list[Chain]:
    """Return the chains to carry out next: what others wait for, or else all that need not wait.

    Args:
        chains: All, in their order.
        done: Names of the jobs that are done.
        tried: Chains that were carried out, whether or not they failed.
    """
    left = [c for c in chains if c not in tried and not all(job.name in done for job in c)]
    ready = [chain for chain in left if _needs(chain) <= set(done)]
    needed = {name for chain in left for name in _needs(chain)} - set(done)
    first = [chain for chain in ready if any(job.name in needed for job in chain)]
    return first or ready


def _needs(chain: Chain) -> set[str]:
    """Return the names of the jobs of other chains that a chain needs."""
    return {name for job in chain for name in job.after} - {job.name for job in chain}
