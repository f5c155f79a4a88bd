"""Which experiments to carry out (paper, section V), as data, and the file that keeps them."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from mechsearch.algorithm import RunConfig
from mechsearch.evaluation.policies import LOOK_AHEAD, policy_names
from mechsearch.experiments.folder import SweepFolder
from mechsearch.files import (
    read_record,
    record_from_json,
    write_record,
)
from mechsearch.heaps.dataset import CONDITIONS, HeapSet, check_objects, load_heaps, object_set
from mechsearch.heaps.generate import GenerateConfig
from mechsearch.teachers import PAPER_TEACHERS
from mechsearch.training.assemble import SHIPPED_NETWORK
from mechsearch.training.config import run_config
from mechsearch.types import MechSearchError

VARIANTS = ("method", "ddpg", "no-teachers", "no-asymmetry", "no-pose-input", "plus")
REFERENCES = ("random", "idle", *(f"teacher-{name}" for name in PAPER_TEACHERS), LOOK_AHEAD)


def _check_names(what: str, names: Sequence[str], known: Sequence[str]) -> None:
    unknown = [name for name in names if name not in known]
    if unknown:
        raise MechSearchError(f"unknown {what} {unknown[0]!r}; choose among {', '.join(known)}")
    if len(set(names)) < len(names):
        raise MechSearchError(f"a {what} is named twice in {', '.join(names)}; expected each once")


@dataclass(frozen=True)
class SweepPlan:
    """All experiments of the paper's section V, unless it says otherwise.

    Attributes:
        experiment: First column of the summary.
        objects: Object set; empty takes the one that the heap sets name, or "household".
        heaps_single: Heap set file of the single condition; empty generates one.
        heaps_dual: Likewise of the dual condition.
        generate_single: Single heaps to generate where no file is given.
        generate_dual: Dual heaps likewise.
        conditions: "single", "dual" or both.
        variants: What is trained.
        seeds: Of the training runs of each variant.
        actions: Executed in each run.
        references: Policies that are not trained.
        curve_heaps: Held-out heaps that curves are drawn on, the same for all runs.
        curve_every: Actions between two points of a curve; `actions` of `plus` are a multiple.
        curve_grasps: Variants whose curves have graspability too, where `grasps` are measured.
        final_heaps: Held-out heaps of the final scores, the same for all policies.
        grasps: Whether final episodes are also measured by graspability and retrieval.
        grasp_network: File of the grasp network to do it with; empty takes the shipped one.
    """

    experiment: str = "paper"
    objects: str = ""
    heaps_single: str = ""
    heaps_dual: str = ""
    generate_single: int = 3000
    generate_dual: int = 1200
    conditions: tuple[str, ...] = ("single", "dual")
    variants: tuple[str, ...] = VARIANTS
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    actions: int = 8000
    references: tuple[str, ...] = REFERENCES
    curve_heaps: int = 50
    curve_every: int = 1000
    curve_grasps: tuple[str, ...] = ("method", "ddpg")
    final_heaps: int = 300
    grasps: bool = True
    grasp_network: str = ""

    def __post_init__(self) -> None:
        _check_names("condition", self.conditions, tuple(CONDITIONS))
        _check_names("variant", self.variants, VARIANTS)
        _check_names("variant", self.curve_grasps, VARIANTS)
        _check_names("reference", self.references, (*policy_names(), LOOK_AHEAD))
        if not self.conditions:
            raise MechSearchError(f"no condition is named; choose among {', '.join(CONDITIONS)}")
        if len(set(self.seeds)) < len(self.seeds) or any(seed < 0 for seed in self.seeds):
            raise MechSearchError(f"seeds are {self.seeds}; expected each once, none below 0")
        if self.variants and not self.seeds:
            raise MechSearchError("no seed is named; expected at least one for each variant")
        for name in ("actions", "curve_heaps", "curve_every", "final_heaps"):
            if getattr(self, name) < 1:
                raise MechSearchError(f"{name} is {getattr(self, name)}; expected at least 1")
        for variant in self.variants:
            self.config(variant, 0)

    def heap_file(self, condition: str) -> str:
        """Return the heap set file that was given for a condition; empty if none was."""
        return self.heaps_single if condition == "single" else self.heaps_dual

    def generated(self, condition: str) -> GenerateConfig:
        """Return what to generate where no heap set is given."""
        number = self.generate_single if condition == "single" else self.generate_dual
        return GenerateConfig(condition, number, self.objects or "household")

    def config(self, variant: str, seed: int) -> RunConfig[Any]:
        """Return the configuration of one run."""
        grasped = self.grasps and variant in self.curve_grasps
        config = run_config(variant)
        schedule = replace(
            config.schedule,
            actions=self.actions,
            evaluate_every=self.curve_every,
            checkpoint_every=min(self.curve_every, 1000),
            # Nothing is chosen by validation here, so all training heaps are learnt on.
            validation_heaps=0,
            held_out_heaps=self.curve_heaps,
            grasp_network=(self.grasp_network or SHIPPED_NETWORK) if grasped else "",
        )
        return replace(config, seed=seed, schedule=schedule)


QUICK = SweepPlan(
    experiment="quick",
    objects="household",
    generate_single=60,
    generate_dual=60,
    variants=("method", "ddpg", "plus"),
    seeds=(0, 1),
    actions=600,
    curve_heaps=12,
    curve_every=300,
    final_heaps=24,
    grasps=False,
)
"""A small version of everything, in a quarter of an hour: too small to judge the method by."""


def open_plan(plan: SweepPlan, folder: SweepFolder) -> None:
    """Write a plan into a new folder, or check that the folder is of the same plan.

    Raises:
        MechSearchError: If the folder is of another plan, naming what differs, or of no sweep; or
            if heaps and objects do not fit the plan.
    """
    found = _described(plan, {c: _checked(plan, c) for c in plan.conditions})
    if not folder.plan.exists():
        others = [file.name for file in folder.path.iterdir() if not file.name.startswith(".")]
        if others:
            raise MechSearchError(
                f"{folder.path} holds {', '.join(sorted(others)[:5])} and no {folder.plan.name}; "
                "name a new folder"
            )
        write_record(folder.plan, "plan of a sweep", found)
        return
    kept = _read(folder)
    names = [name for name in {**kept, **found} if kept.get(name) != found.get(name)]
    # The heap sets are compared by their content, wherever they lie.
    names = [name for name in names if not name.startswith("heaps_")]
    if names:
        told = [f"{n} was {kept.get(n)!r} and is {found.get(n)!r}" for n in names]
        raise MechSearchError(f"{folder.path} holds a sweep of another plan: {'; '.join(told)}")


def read_plan(folder: SweepFolder) -> SweepPlan:
    """Return the plan of a sweep.

    Raises:
        MechSearchError: If there is none, or it is damaged.
    """
    known = {field.name for field in fields(SweepPlan)}
    return record_from_json(
        SweepPlan, {name: value for name, value in _read(folder).items() if name in known}
    )


def described(plan: SweepPlan) -> Sequence[tuple[str, str]]:
    """Return the plan in words: name and value of each choice that is made."""
    values = [(field.name.replace("_", " "), getattr(plan, field.name)) for field in fields(plan)]
    return [(name, _text(value)) for name, value in values if value not in ("", ())]


def _text(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _read(folder: SweepFolder) -> dict[str, Any]:
    return read_record(folder.plan, "plan of a sweep", ("experiment", "version"))


def _described(plan: SweepPlan, heap_sets: dict[str, str]) -> dict[str, Any]:
    content = {**asdict(plan), "heap_sets": heap_sets, "version": version("mechsearch")}
    # As it will be read back: lists for tuples.
    plain: dict[str, Any] = json.loads(json.dumps(content))
    return plain


def _checked(plan: SweepPlan, condition: str) -> str:
    """Return the hash of the heap set that is given, or "generated", if it fits the plan."""
    file = plan.heap_file(condition)
    if not file:
        object_set(plan.generated(condition).objects)
        held_out = plan.generated(condition).heaps // 2
        _check_sizes(plan, f"the {condition} heaps that are generated", held_out)
        return "generated"
    heap_set = load_heaps(Path(file))
    _check_condition(heap_set, condition, file)
    check_objects(heap_set, object_set(plan.objects or str(heap_set.manifest["config"]["objects"])))
    _check_sizes(plan, file, len(heap_set.held_out))
    return heap_set.hash


def _check_condition(heap_set: HeapSet, condition: str, file: str) -> None:
    found = heap_set.manifest["config"]["condition"]
    if found != condition:
        raise MechSearchError(f"{file} holds {found} heaps; expected {condition} ones")


def _check_sizes(plan: SweepPlan, file: str, held_out: int) -> None:
    for name in ("final_heaps", "curve_heaps"):
        if getattr(plan, name) > held_out:
            raise MechSearchError(
                f"{name} is {getattr(plan, name)}, but {file} has {held_out} held-out heaps"
            )
