"""What a disk, a hand or another version has changed is named and refused, never used."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from mechsearch import files
from mechsearch.env.heap_env import TaskConfig
from mechsearch.evaluation import episodes
from mechsearch.evaluation.episodes import EpisodeRecord, Evaluation
from mechsearch.experiments.folder import SweepFolder
from mechsearch.experiments.plan import QUICK, read_plan
from mechsearch.experiments.sweep import Journal
from mechsearch.files import records
from mechsearch.files import tensors as weights
from mechsearch.findings.experiment import read_run
from mechsearch.grasp.learning import grasp_folder
from mechsearch.grasp.learning.grasp_folder import GraspFolder
from mechsearch.grasp.learning.labelling import Grasps, load_grasps
from mechsearch.grasp.network import SHIPPED_GRASP_NETWORK, GraspNetwork, load_network, save_network
from mechsearch.heaps import dataset
from mechsearch.objects.meshes.cache import model_from_npz, model_to_npz
from mechsearch.push_values.algorithm import PushValues
from mechsearch.push_values.episodes import EpisodeOfPushes, load_episode, save_episode
from mechsearch.push_values.policy import PushPolicy, PushPolicyConfig
from mechsearch.push_values.value import Continuation, PushSamples, PushValue, PushValueConfig
from mechsearch.pushes.push import NUMBERS, PATCH
from mechsearch.training import run_directory
from mechsearch.training.config import load_config
from mechsearch.training.loop import learn
from mechsearch.training.run import RunInputs
from mechsearch.training.run_directory import RunDirectory, load_policy, save_policy, trained
from mechsearch.types import MechSearchError


@dataclass(frozen=True)
class Kind:
    """A kind of file: what writes it into a folder, under which name, and what reads it there."""

    file: str
    write: Callable[[Path], object]
    read: Callable[[Path], Any]
    format: tuple[object, str] | None = None
    """Module and name of the number of its format."""

    strict: bool = True
    """Whether every bit matters; archives have some that no reader looks at."""


def plain(value: Any) -> Any:
    """Return anything as something that `==` compares to the last bit."""
    if isinstance(value, torch.nn.Module):
        value = dict(value.state_dict())
    if is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, torch.Tensor):
        value = value.numpy()
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, dict):
        return {name: plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    return value


@pytest.fixture(scope="module")
def kinds(config, make_parts, covered, make_box, tmp_path_factory):
    run = tmp_path_factory.mktemp("corruption") / "run"
    short = config.changed(actions=26, evaluate_every=13)
    learn(short, make_parts(), run)
    last = "checkpoints/step-00000026.safetensors"

    def copied(*names):
        def write(folder):
            for name in names:
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes((run / name).read_bytes())

        return write

    def record(name, purpose, content):
        return lambda folder: files.write_record(folder / name, purpose, content)

    rng = np.random.default_rng(1)
    grasps = Grasps(
        rng.normal(size=(3, 96, 96)).astype(np.float16),
        rng.uniform(size=3).astype(np.float32),
        np.arange(3, dtype=np.uint8),
        np.zeros(3, np.uint8),
        np.ones(3, np.bool_),
        np.arange(3),
        np.array(["cup", "box", "cup"]),
    )
    samples = PushSamples(
        torch.rand(5, *PATCH).half(), torch.rand(5, NUMBERS), torch.rand(5), torch.rand(5, 5)
    )
    pushes = EpisodeOfPushes(samples, torch.rand(2, 2), {"heap": 3, "end": "uncovered"})
    values = [PushValue(PushValueConfig(filters=4, hidden=(8, 4))) for _ in range(2)]
    plus = trained(
        PushPolicy(values, Continuation(), PushPolicyConfig(12)), PushValues(), 60, TaskConfig()
    )
    episode = EpisodeRecord(
        *(7, 2, "single", "idle", ("cup", "box"), 0),
        *(np.zeros((3, 3), np.float32), rng.normal(size=(4, 3)), rng.uniform(size=4)),
        *(rng.normal(size=(4, 2, 7)), {"idle": np.ones(3)}, np.zeros(3), np.zeros(3)),
        *("uncovered", 50),
    )
    manifest = {
        "format": dataset.HEAPS_FORMAT,
        "config": {"objects": "boxes", "camera": "overhead"},
    }
    inputs = {"heaps": "a.parquet", "heap_set": "ab12", "objects": "ycb"}
    plan = json.loads(json.dumps({**asdict(QUICK), "version": "1.0"}))
    over = "record of a finished run"

    def write_journal(folder):
        journal = Journal(folder / "jobs.jsonl")
        journal.begin(2)
        for number in range(5):
            journal.write("began", job=f"single/method-seed{number}")

    actor = "actor.safetensors"
    of_run = ("config.json", "metrics.jsonl", last)
    record_format, archive_format = (records, "RECORD"), (weights, "ARCHIVE_FORMAT")
    kinds = {
        "heap set": Kind(
            "heaps.parquet",
            lambda f: dataset.save_heaps(f / "heaps.parquet", [covered] * 3, manifest),
            lambda f: dataset.load_heaps(f / "heaps.parquet"),
            strict=False,
        ),
        "run configuration": Kind(
            "config.json", copied("config.json"), lambda f: load_config(f / "config.json"),
            record_format,
        ),
        "run inputs": Kind(
            "inputs.json",
            record("inputs.json", "record of a run's inputs", inputs),
            RunInputs.of_run,
            record_format,
        ),
        "metrics": Kind("metrics.jsonl", copied("config.json", "metrics.jsonl"), read_run),
        "checkpoint": Kind(
            last, copied(*of_run), lambda f: RunDirectory(f).open(short, resume=True),
            (run_directory, "CHECKPOINT_FORMAT"),
        ),
        "actor": Kind(actor, copied(actor), lambda f: load_policy(f).policy.actor, archive_format),
        "episodes": Kind(
            "idle.npz",
            lambda f: episodes.save_episodes(
                f / "idle.npz", Evaluation({"name": "idle"}, (episode,))
            ),
            lambda f: episodes.load_episodes(f / "idle.npz"),
            (episodes, "EPISODE_FORMAT"),
            strict=False,
        ),
        "prepared object": Kind(
            "plate.npz",
            lambda f: model_to_npz(f / "plate.npz", make_box("plate", (0.1, 0.1, 0.02))),
            lambda f: model_from_npz(f / "plate.npz"),
            strict=False,
        ),
        "pushes of an episode": Kind(
            "pushes/000003.safetensors",
            lambda f: save_episode(pushes, f / "pushes/000003.safetensors"),
            lambda f: load_episode(f / "pushes/000003.safetensors"),
            archive_format,
        ),
        "push policy": Kind(
            "plus.safetensors",
            lambda f: save_policy(plus, f / "plus.safetensors"),
            lambda f: load_policy(f / "plus.safetensors").policy.networks,
            archive_format,
        ),
        "labelled grasps": Kind(
            "grasps-00000.npz",
            lambda f: GraspFolder(f, {"seed": 1}).add("grasps-00000.npz", grasps),
            load_grasps,
        ),
        "manifest of labelled grasps": Kind(
            "grasps.json",
            lambda f: GraspFolder(f, {"seed": 1}).add("grasps-00000.npz", grasps),
            load_grasps,
            (grasp_folder, "_FORMAT"),
        ),
        "grasp network": Kind(
            "network.safetensors",
            lambda f: save_network(f / "network.safetensors", GraspNetwork(), {}),
            lambda f: load_network(f / "network.safetensors"),
            archive_format,
        ),
        "plan of a sweep": Kind(
            "sweep.json",
            record("sweep.json", "plan of a sweep", plan),
            lambda f: read_plan(SweepFolder(f)),
            record_format,
        ),
        "record of a finished run": Kind(
            "finished.json",
            record("finished.json", over, {"actor": "ab12", "training_actions": 60}),
            lambda f: files.read_record(f / "finished.json", over, ["actor"]),
            record_format,
        ),
        "journal of a sweep": Kind(
            "jobs.jsonl", write_journal, lambda f: Journal(f / "jobs.jsonl").records(), strict=False
        ),
    }  # fmt: skip
    return kinds


KINDS = (
    *("heap set", "run configuration", "run inputs", "metrics", "checkpoint", "actor"),
    *("episodes", "prepared object", "pushes of an episode", "push policy"),
    *("labelled grasps", "manifest of labelled grasps", "grasp network", "plan of a sweep"),
    *("record of a finished run", "journal of a sweep"),
)
LINES = ("metrics", "journal of a sweep")
"""Files of lines: a kill cuts the last one, which is left out; the journal leaves out any."""


def read_or_refused(kind: Kind, folder: Path) -> Any:
    """Return what is read as `plain` has it, or None where it is refused by the file's name."""
    try:
        return plain(kind.read(folder))
    except MechSearchError as error:
        said = str(error)
    assert Path(kind.file).name in said
    return None


def is_part(found: Any, sound: Any) -> bool:
    """Return whether the journal's events are some of those that were written."""
    return isinstance(found, list) and all(record in sound for record in found)


@pytest.mark.parametrize("name", KINDS)
def test_a_flipped_bit_is_refused_or_changes_nothing_that_is_read(name, kinds, tmp_path):
    kind, rng = kinds[name], np.random.default_rng(2)
    kind.write(tmp_path)
    file = tmp_path / kind.file
    content, sound = file.read_bytes(), plain(kind.read(tmp_path))
    refused = 0
    # The last byte of a file of lines ends a line that a kill may have cut.
    for place in rng.integers(len(content) - 1, size=24):
        flipped = bytearray(content)
        flipped[place] ^= 1 << int(rng.integers(8))
        file.write_bytes(bytes(flipped))
        found = read_or_refused(kind, tmp_path)
        assert found in (None, sound) or (kind.file == "jobs.jsonl" and is_part(found, sound))
        refused += found != sound
    assert refused == 24 if kind.strict else refused >= 12


@pytest.mark.parametrize("name", KINDS)
def test_a_cut_file_is_refused(name, kinds, tmp_path):
    kind = kinds[name]
    kind.write(tmp_path)
    file = tmp_path / kind.file
    content, sound = file.read_bytes(), plain(kind.read(tmp_path))
    for length in (0, 2 * len(content) // 5, len(content) - 3):
        file.write_bytes(content[:length])
        found = read_or_refused(kind, tmp_path)
        if name == "metrics":
            lines = [line for kept in found["records"].values() for line in kept] if found else []
            assert len(lines) == file.read_bytes().count(b"\n")
        else:
            assert found is None or (name in LINES and is_part(found, sound))


@pytest.mark.parametrize("name", [name for name in KINDS if name not in LINES])
@pytest.mark.parametrize(
    "content", [b"\x89PNG\r\n\x1a\n", b"{}", b"[1, 2]", b'"text"', b"PAR1", b"PK\x05\x06"]
)
def test_a_foreign_file_is_refused(name, content, kinds, tmp_path):
    kind = kinds[name]
    kind.write(tmp_path)
    (tmp_path / kind.file).write_bytes(content)
    assert read_or_refused(kind, tmp_path) is None


@pytest.mark.parametrize("name", KINDS)
def test_a_file_of_another_kind_is_refused(name, kinds, tmp_path):
    """Such as an actor in a checkpoint's place, or a manifest in the configuration's."""
    kind = kinds[name]
    kind.write(tmp_path)
    sound = plain(kind.read(tmp_path))
    for other in kinds.values():
        policies = {kind.file, other.file} <= {"actor.safetensors", "plus.safetensors"}
        if (
            Path(other.file).suffix == Path(kind.file).suffix
            and other.file != kind.file
            and not policies
        ):
            place = tmp_path / "other"
            other.write(place)
            (tmp_path / kind.file).write_bytes((place / other.file).read_bytes())
            found = read_or_refused(kind, tmp_path)
            assert found is None or (name in LINES and found != sound)


@pytest.mark.parametrize("name", [name for name in KINDS if name not in LINES])
def test_a_file_of_a_later_format_is_refused_by_its_number(name, kinds, tmp_path, monkeypatch):
    kind = kinds[name]
    if kind.format is None:
        pytest.skip("its folder or its name has the number")
    with monkeypatch.context() as later:
        later.setattr(*kind.format, 99)
        if name in ("run configuration", "checkpoint", "actor"):
            later_again(name, kinds, tmp_path)
        else:
            kind.write(tmp_path)
    with pytest.raises(MechSearchError, match="99"):
        kind.read(tmp_path)


def later_again(name: str, kinds: dict[str, Kind], folder: Path) -> None:
    """Write anew what a run wrote, for whatever the number of the format is now."""
    kind = kinds[name]
    kind.write(folder)
    file = folder / kind.file
    if name == "run configuration":
        content = json.loads(file.read_text())
        del content["check"], content["record"], content["kind"]
        files.write_record(file, "training configuration", content)
        return
    with pytest.MonkeyPatch.context() as now:
        now.setattr(weights, "ARCHIVE_FORMAT", 1)
        archive = weights.load_archive(file, f"mechsearch {name}")
    if name == "checkpoint":
        archive = replace(
            archive, meta={**archive.meta, "checkpoint": run_directory.CHECKPOINT_FORMAT}
        )
    weights.save_archive(file, archive)


def test_a_record_of_an_earlier_version_has_no_checksum_and_is_read(tmp_path):
    file = tmp_path / "finished.json"
    file.write_text('{"actor": "ab12"}')
    assert files.read_record(file, "record") == {"actor": "ab12"}
    (tmp_path / "old.jsonl").write_text('{"step": 1}\n{"step": 2}\n{"step"')
    assert list(files.read_lines(tmp_path / "old.jsonl")) == [{"step": 1}, {"step": 2}]


def test_what_was_changed_by_hand_is_told(tmp_path):
    file = tmp_path / "config.json"
    files.write_record(file, "configuration", {"seed": 1})
    file.write_text(file.read_text().replace('"seed": 1', '"seed": 2'))
    with pytest.raises(MechSearchError, match="changed by hand"):
        files.read_record(file, "configuration")


def test_the_shipped_grasp_network_is_the_one_of_its_card():
    card = json.loads(SHIPPED_GRASP_NETWORK.with_suffix(".json").read_text())
    assert hashlib.sha256(SHIPPED_GRASP_NETWORK.read_bytes()).hexdigest() == card["sha256"]
