"""Files that hold anything at all: every reader answers with a MechSearchError, or reads them."""

import io
import json
import warnings
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import safetensors.numpy
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from PIL import Image

from mechsearch.algorithm import RunConfig
from mechsearch.benchmark.submission import load_submission
from mechsearch.cli import main
from mechsearch.evaluation import episodes
from mechsearch.files import read_json
from mechsearch.grasp.camera_files import read_camera
from mechsearch.grasp.depth_image import read_view
from mechsearch.grasp.network import load_network
from mechsearch.heaps import dataset
from mechsearch.objects.catalog import read_masses
from mechsearch.objects.meshes.cache import model_from_npz
from mechsearch.objects.meshes.prepare import read_pieces
from mechsearch.push_values.episodes import load_episode
from mechsearch.training.config import load_config
from mechsearch.training.run_directory import load_policy
from mechsearch.types import MechSearchError

CORPUS = sorted(path for path in (Path(__file__).parent / "corpus").rglob("*") if path.is_file())
HEAPS = str(Path(dataset.__file__).with_name("household_single.parquet"))

COMMANDS = """
objects list --objects FILE
objects sheet --objects FILE --out OUT/a.png
heaps generate --objects FILE --out OUT/h.parquet
heaps show FILE
heaps show HEAPS --objects FILE --out OUT/a.png
heaps verify FILE --workers 1
train debug --heaps FILE --out OUT/run
train debug --heaps HEAPS --objects FILE --out OUT/run
train --resume FILE
evaluate idle --heaps FILE --out OUT
evaluate FILE --out OUT
evaluate idle --objects FILE --out OUT
evaluate idle --grasp-network FILE --out OUT
sweep --status --out FILE
sweep --quick --grasps True --grasp-network FILE --out OUT
verify FILE --heaps HEAPS --workers 1
verify EPISODES --heaps FILE --workers 1
show FILE --out OUT/a.png
show EPISODES --objects FILE --out OUT/a.gif
export episodes FILE --format lerobot --out OUT/a --workers 1
status FILE
pack FILE --scores EPISODES --out OUT/a.safetensors
report FILE
grasp score --heaps FILE
grasp score --heaps HEAPS --network FILE
grasp score --depth FILE --mask FILE --intrinsics FILE
grasp lift --heaps FILE
grasp lift --gripper jaws-85 --heaps FILE
grasp lift --gripper jaws-85 --heaps HEAPS --network FILE
grasp label --heaps FILE --out OUT
grasp label --gripper suction --heaps FILE --out OUT
grasp label --gripper suction --heaps HEAPS --network FILE --out OUT
grasp train --labels FILE --out OUT
grasp train --gripper suction --labels FILE --out OUT
grasp test --labels FILE
grasp test --gripper suction --labels FILE
grasp calibrate FILE
grasp ceiling --gripper suction --heaps FILE
grasp ceiling --gripper suction --heaps HEAPS --networks FILE
""".strip().splitlines()
"""What every command that reads a file is told, and where the file stands."""

READERS = {
    "heaps.parquet": dataset.load_heaps,
    "episodes.npz": episodes.load_episodes,
    "submission.npz": load_submission,
    "config.json": load_config,
    "actor.safetensors": load_policy,
    "plus.safetensors": load_policy,
    "pushes.safetensors": load_episode,
    "grasp.safetensors": load_network,
    "grasp.npz": load_network,
    "masses.csv": read_masses,
    "summary.csv": episodes.read_summary,
    "object.npz": model_from_npz,
    "mesh.obj": read_pieces,
    "mesh.stl": read_pieces,
    "mesh.glb": read_pieces,
    "camera.yaml": lambda path: read_camera(path, (4, 6)),
    "view.npz": read_view,
    "view.npy": lambda path: read_view(path, path, path),
    "view.png": lambda path: read_view(path, path, path),
    "view.json": lambda path: read_json(path, "view"),
}
HEADS = (b"", b"PK\x03\x04", b"\x93NUMPY\x01\x00", b"PAR1", b"glTF\x02\x00\x00\x00", b"\x89PNG\r\n")
MANY = settings(
    deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture]
)

scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
json_values = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4)
    ),
    max_leaves=8,
)


@pytest.fixture(scope="module")
def garbage(tmp_path_factory):
    """Files and folders of every kind but those that are asked for."""
    folder = tmp_path_factory.mktemp("garbage")
    picture = io.BytesIO()
    Image.new("RGB", (12, 9)).save(picture, "png")
    arrays = io.BytesIO()
    np.savez(arrays, allow_pickle=False, depth=np.ones(3))
    cut = Path(HEAPS).read_bytes()[:-99]
    everywhere = ("", ".parquet", ".npz", ".safetensors", ".csv", ".json", ".png")
    for name, content, suffixes in (
        ("empty", b"", everywhere),
        ("text", "größe\nnull,\x00\n".encode(), everywhere),
        ("picture", picture.getvalue(), ("", ".png", ".parquet", ".npz")),
        ("arrays", arrays.getvalue(), (".npz", ".parquet")),
        ("cut", cut, (".parquet",)),
        ("object", b"{}", (".json",)),
        ("list", b"[1, null]", (".json", ".safetensors")),
    ):
        for suffix in suffixes:
            (folder / f"{name}{suffix}").write_bytes(content)
    (folder / "folder").mkdir()
    (folder / "folder.npz").mkdir()
    return [*folder.iterdir(), folder / "missing", folder / "missing.npz", folder / "text" / "a"]


@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_meets_a_wrong_file_with_a_traceback(
    command, garbage, small_evaluation, tmp_path, monkeypatch, capsys
):
    if command.split()[0] in ("train", "sweep", "pack", "grasp") or "grasp" in command:
        pytest.importorskip("torch")
    monkeypatch.chdir(tmp_path)
    fixed = {"HEAPS": HEAPS, "EPISODES": str(small_evaluation)}
    for file in (*garbage, *CORPUS):
        given = {**fixed, "FILE": str(file)}
        words = [given.get(word, word.replace("OUT", "out")) for word in command.split()]
        code = 0
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                main(words)
        except SystemExit as stopped:
            code = stopped.code
        said = capsys.readouterr().err.splitlines()
        lines = [line for line in said if line.startswith("mechsearch: ")]
        # What is in the corpus may be what is asked for.
        if code or file not in CORPUS:
            assert (code, lines) == (2, said[-1:]), (words, said)


def answered(reader, path):
    """Let a reader meet a file; anything but an answer or a MechSearchError fails the test."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return reader(path)
        except MechSearchError as error:
            assert str(error).strip()  # noqa: PT017
            return None


@pytest.mark.parametrize("name", READERS)
@MANY
@given(head=st.sampled_from(HEADS), body=st.binary(max_size=200))
def test_bytes_of_any_kind_are_refused_in_words(name, head, body, tmp_path):
    (tmp_path / name).write_bytes(head + body)
    answered(READERS[name], tmp_path / name)


@pytest.mark.parametrize(
    "name", [*("masses.csv", "summary.csv", "mesh.obj", "config.json", "camera.yaml")]
)
@MANY
@given(text=st.text(alphabet="object,mass_kg\n\"'-.0123456789eE vf/#{}[]:nan\x00é", max_size=120))
def test_text_of_any_kind_is_refused_in_words(name, text, tmp_path):
    (tmp_path / name).write_text(text, encoding="utf-8")
    answered(READERS[name], tmp_path / name)


@MANY
@given(rows=st.text(alphabet='ab,"\n 1.e-nainf', max_size=60))
def test_a_table_of_masses_holds_positive_numbers_or_is_refused(rows, tmp_path):
    (tmp_path / "masses.csv").write_text("object,mass_kg\n" + rows, encoding="utf-8")
    entries = answered(read_masses, tmp_path / "masses.csv") or {}
    assert all(0 < entry.mass < float("inf") for entry in entries.values())


@MANY
@given(value=json_values)
@example(value=[])
@example(value={"name": 3})
def test_json_of_any_shape_is_a_configuration_or_refused(value, tmp_path):
    (tmp_path / "config.json").write_text(json.dumps(value))
    config = answered(load_config, tmp_path / "config.json")
    assert config is None or isinstance(config, RunConfig)


@MANY
@given(
    name=st.sampled_from([*RunConfig.__dataclass_fields__]),
    inner=st.sampled_from(["", "gamma", "network", "hidden", "sigma", "networks", "value"]),
    value=json_values,
)
def test_a_configuration_with_any_field_replaced_is_one_or_is_refused(name, inner, value, tmp_path):
    (tmp_path / "config.json").write_text(json.dumps({name: {inner: value} if inner else value}))
    config = answered(load_config, tmp_path / "config.json")
    assert config is None or isinstance(config, RunConfig)


@MANY
@given(text=json_values, rows=st.integers(0, 3))
def test_an_archive_of_other_arrays_is_no_evaluation(text, rows, tmp_path):
    for name in ("episodes.npz", "object.npz", "grasp.npz", "view.npz"):
        np.savez(
            tmp_path / name,
            text=np.array(json.dumps(text)),
            depth=np.ones((rows, rows)),
            mask=np.ones(rows),
            K=np.zeros((3, 3)),
            allow_pickle=False,
        )
        answered(READERS[name], tmp_path / name)


@MANY
@given(
    part=st.sampled_from(["header", "terms", "episodes", "format"]),
    value=json_values,
)
def test_an_evaluation_with_any_part_replaced_is_one_or_is_refused(
    part, value, small_evaluation, tmp_path
):
    with np.load(small_evaluation, allow_pickle=False) as file:
        arrays = dict(file)
    text = json.loads(str(arrays["text"]))
    text[part] = value
    arrays["text"] = np.array(json.dumps(text))
    np.savez(tmp_path / "episodes.npz", allow_pickle=False, **arrays)
    answered(episodes.load_episodes, tmp_path / "episodes.npz")


@pytest.fixture(scope="module")
def small_evaluation(tmp_path_factory):
    path = tmp_path_factory.mktemp("evaluation") / "episodes.npz"
    record = episodes.EpisodeRecord(
        1, 2, "single", "idle", ("a", "b"), 0, np.zeros((1, 3), np.float32), np.zeros((2, 3)),
        np.zeros(2), np.zeros((2, 2, 7)), {"idleness": np.zeros(1)}, np.zeros(1), np.zeros(1),
        "action limit", 50,
    )  # fmt: skip
    episodes.save_episodes(path, episodes.Evaluation({"name": "idle"}, (record,)))
    return path


@MANY
@given(manifest=json_values, poses=st.lists(st.floats(), max_size=9), drop=st.integers(0, 8))
def test_a_table_of_other_rows_is_no_heap_set(manifest, poses, drop, tmp_path):
    row = {
        "objects": ["a"], "poses": poses, "target": 0, "occlusion": 0.5, "seed": 1, "count": 1,
        "condition": "single", "held_out": False,
    }  # fmt: skip
    row = dict(list(row.items())[:drop])
    table = pa.Table.from_pylist([row]).replace_schema_metadata(
        {b"mechsearch": json.dumps(manifest).encode(), b"sha256": b"0"}
    )
    pq.write_table(table, tmp_path / "heaps.parquet")
    assert answered(dataset.load_heaps, tmp_path / "heaps.parquet") is None


@MANY
@given(meta=json_values)
def test_weights_of_another_origin_are_refused(meta, tmp_path):
    header = {"mechsearch": json.dumps(meta)}
    for name in (name for name in READERS if name.endswith(".safetensors")):
        safetensors.numpy.save_file({"x": np.zeros(2, np.float32)}, tmp_path / name, header)
        assert answered(READERS[name], tmp_path / name) is None


@pytest.mark.parametrize("kind", ["L", "LA", "P", "RGB", "RGBA", "1", "I;16"])
@MANY
@given(width=st.integers(1, 12), height=st.integers(1, 12), camera=json_values)
def test_pictures_of_any_size_and_intrinsics_of_any_shape(kind, width, height, camera, tmp_path):
    picture = io.BytesIO()
    Image.new(kind, (width, height)).save(picture, "png")
    (tmp_path / "view.png").write_bytes(picture.getvalue())
    names = ("fx", "fy", "cx", "cy")
    for value in (camera, dict.fromkeys(names, camera), dict.fromkeys(names, 1.0)):
        (tmp_path / "camera.json").write_text(json.dumps(value))
        answered(
            lambda path: read_view(path, path, tmp_path / "camera.json"), tmp_path / "view.png"
        )
