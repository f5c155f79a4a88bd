"""Which experiments to carry out (paper, section V), as data, and the file that keeps them."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from mechsearch.algorithm import RunConfig
from mechsearch.env import TaskConfig
from mechsearch.evaluation.policies import LOOK_AHEAD, policy_names
from mechsearch.evaluation.rollout import differing
from mechsearch.experiments.folder import SweepFolder
from mechsearch.files import differing_fields, read_record, record_from_json, write_record
from mechsearch.heaps.dataset import CONDITIONS, object_set, open_heaps
from mechsearch.heaps.generate import GenerateConfig
from mechsearch.teachers import PAPER_TEACHERS
from mechsearch.training.assemble import SHIPPED_NETWORK
from mechsearch.training.config import run_config
from mechsearch.types import MechSearchError

VARIANTS = (
    *("method", "ddpg", "no-teachers", "no-asymmetry", "no-pose-input", "plus"),
    *("as-printed", "as-printed-no-teachers", "as-printed-no-asymmetry"),
    "as-printed-no-pose-input",
)
REFERENCES = ("random", "idle", *(f"teacher-{name}" for name in PAPER_TEACHERS), LOOK_AHEAD)

_PURPOSE = "plan of a sweep"


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
        heaps_single: Heap set file (.parquet) of the single condition; empty generates one.
        heaps_dual: Likewise of the dual condition.
        generate_single: Single heaps to generate where no file is given.
        generate_dual: Dual heaps likewise.
        conditions: "single", "dual" or both.
        variants: What is trained: those of `VARIANTS`, an algorithm by itself, or
            package.module:factory.
        seeds: Of the training runs of each variant.
        actions: Executed in each run.
        references: Policies that are not trained: random, idle, the teachers, look-ahead.
        curve_heaps: Held-out heaps that curves are drawn on, the same for all runs.
        curve_every: Actions between two points of a curve; `actions` of `plus` are a multiple.
        curve_grasps: Variants whose curves have graspability too, where `grasps` are measured.
        final_heaps: Held-out heaps of the final scores, the same for all policies.
        grasps: Whether final episodes are also measured by graspability and retrieval.
        grasp_network: File of the grasp network (.safetensors or .npz) to do it with; empty takes
            the shipped one.
        task: What is learnt, and what all policies are scored in.
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
    task: TaskConfig = field(default_factory=TaskConfig)

    def __post_init__(self) -> None:
        _check_names("condition", self.conditions, tuple(CONDITIONS))
        for variants in (self.variants, self.curve_grasps):
            names = [run_config(variant).name for variant in variants]
            _check_names("variant", names, names)
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
        objects = self.objects or "household"
        return GenerateConfig(condition, number, objects, camera=self.task.camera)

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
        return replace(config, seed=seed, task=self.task, schedule=schedule)


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
    heap_sets = {condition: _checked(plan, condition) for condition in plan.conditions}
    facts = {"heap_sets": heap_sets, "version": version("mechsearch")}
    if not folder.plan.exists():
        others = [file.name for file in folder.path.iterdir() if not file.name.startswith(".")]
        if others:
            raise MechSearchError(
                f"{folder.path} holds {', '.join(sorted(others)[:5])} and no {folder.plan.name}; "
                "name a new folder"
            )
        write_record(folder.plan, _PURPOSE, asdict(plan) | facts)
        return
    kept = _read(folder)
    found = differing_fields(read_plan(folder), plan)
    # The heap sets are compared by their content, wherever they lie.
    found = [difference for difference in found if not difference[0].startswith("heaps_")]
    found += [(name, kept.get(name), now) for name, now in facts.items() if kept.get(name) != now]
    if found:
        told = [f"{name} was {was!r} and is {now!r}" for name, was, now in found]
        raise MechSearchError(f"{folder.path} holds a sweep of another plan: {'; '.join(told)}")


def read_plan(folder: SweepFolder) -> SweepPlan:
    """Return the plan of a sweep, of this version or of an earlier one.

    Raises:
        MechSearchError: If there is none, or it is damaged.
    """
    known = {field.name for field in fields(SweepPlan)}
    # Earlier versions rated no grasps in curves, and knew one task.
    found = {"curve_grasps": [], **_read(folder)}
    return record_from_json(SweepPlan, {name: found[name] for name in known & found.keys()})


def described(plan: SweepPlan) -> Sequence[tuple[str, str]]:
    """Return the plan in words: name and value of each choice that is made."""
    changed = differing(TaskConfig(), plan.task)
    values = {f.name: getattr(plan, f.name) for f in fields(plan)} | {"task": changed}
    return [
        (name.replace("_", " "), ", ".join(map(str, v)) if isinstance(v, tuple) else str(v))
        for name, v in values.items()
        if v not in ("", ())
    ]


def _read(folder: SweepFolder) -> dict[str, Any]:
    return read_record(folder.plan, _PURPOSE, ("experiment", "version"))


def _checked(plan: SweepPlan, condition: str) -> str:
    """Return the hash of the heap set that is given, or "generated", if it fits the plan."""
    file = plan.heap_file(condition)
    if file:
        heap_set, _ = open_heaps(Path(file), plan.objects)
        held_out, found = len(heap_set.held_out), heap_set.hash
        if heap_set.condition != condition:
            raise MechSearchError(
                f"{file} holds {heap_set.condition} heaps; expected {condition} ones"
            )
    else:
        config = plan.generated(condition)
        object_set(config.objects)
        held_out, found = config.heaps // 2, "generated"
    for name in ("final_heaps", "curve_heaps"):
        if getattr(plan, name) > held_out:
            raise MechSearchError(
                f"{name} is {getattr(plan, name)}, but {file or 'the set to generate'} has "
                f"{held_out} held-out heaps"
            )
    return found
