from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from mechsearch.actor_critic.networks import NetworkConfig
from mechsearch.files import read_lines
from mechsearch.files.tensors import load_archive
from mechsearch.heaps.dataset import HeapSet, load_heaps, object_set
from mechsearch.training.assemble import assemble
from mechsearch.training.config import PRESETS
from mechsearch.training.loop import learn
from mechsearch.training.run_directory import CHECKPOINT_KIND, load_policy
from mechsearch.types import MechSearchError

SMALL = NetworkConfig(filters=4, hidden=(32, 32))


@pytest.fixture(scope="module")
def heap_set(covered):
    heaps = [replace(covered, seed=i, held_out=i % 2 == 1) for i in range(8)]
    return HeapSet(tuple(heaps), {}, "")


@pytest.fixture
def debug():
    learner = replace(PRESETS["debug"].algorithm.learner, network=SMALL)
    return PRESETS["debug"].changed(
        actions=24,
        warmup=8,
        evaluate_every=24,
        checkpoint_every=10,
        validation_heaps=1,
        held_out_heaps=1,
        image_size=32,
        learner=learner,
    )


def test_training_validation_and_held_out_heaps_are_apart(debug, heap_set, boxes):
    parts = assemble(debug, heap_set, boxes)
    validation, held_out = (parts.evaluators[n].heaps for n in ("validation", "held_out"))
    assert not set(parts.heaps) & (set(validation) | set(held_out))
    assert all(not heap_set.heaps[i].held_out for i in (*parts.heaps, *validation))
    assert all(heap_set.heaps[i].held_out for i in held_out)
    assert sorted((*parts.heaps, *validation)) == [0, 2, 4, 6]


def test_held_out_heaps_are_not_watched_unless_asked(debug, heap_set, boxes):
    parts = assemble(debug.changed(held_out_heaps=0), heap_set, boxes)
    assert set(parts.evaluators) == {"validation"}


def test_evaluation_shows_the_actor_its_own_keys_alone(debug, heap_set, boxes):
    env = assemble(debug, heap_set, boxes).evaluators["validation"].env
    assert set(env.observation_space.spaces) == set(debug.algorithm.keys)


def test_too_few_heaps_are_refused(debug, heap_set, boxes):
    with pytest.raises(MechSearchError, match="9 validation heaps asked for; the set has 4"):
        assemble(debug.changed(validation_heaps=9), heap_set, boxes)
    with pytest.raises(MechSearchError, match="leave none to learn on"):
        assemble(debug.changed(validation_heaps=4), heap_set, boxes)


def test_a_real_heap_trains_resumes_and_acts(debug, heap_set, boxes, tmp_path):
    learn(debug, assemble(debug, heap_set, boxes), tmp_path / "whole")
    shorter = debug.changed(actions=20)
    learn(shorter, assemble(shorter, heap_set, boxes), tmp_path / "parts")
    learn(debug, assemble(debug, heap_set, boxes), tmp_path / "parts", resume=True)
    whole, parts = ((tmp_path / n / "metrics.jsonl").read_bytes() for n in ("whole", "parts"))
    assert whole == parts
    kinds = {record["kind"] for record in read_lines(tmp_path / "whole" / "metrics.jsonl")}
    assert kinds >= {"validation", "held_out"}
    policy = load_policy(tmp_path / "whole")
    env = assemble(debug, heap_set, boxes).evaluators["validation"].env
    obs, _ = env.reset(options={"heap": 0, "fixed_start": True})
    assert np.abs(policy.act(obs)).max() <= 1


@pytest.mark.parametrize("actions", [13, 22])
def test_a_run_on_real_heaps_is_made_longer_in_mid_episode_with_all_teachers(
    actions, debug, tmp_path
):
    found = load_heaps(Path(str(resources.files("mechsearch.heaps") / "household_single.parquet")))
    few = HeapSet(tuple(found.heaps[i] for i in (0, 8, 17)), found.manifest, "")
    objects = object_set("household")
    longer = debug.changed(actions=34, held_out_heaps=0, validation_heaps=0, updates_per_action=2)
    learn(longer, assemble(longer, few, objects), tmp_path / "whole")
    shorter = longer.changed(actions=actions)
    learn(shorter, assemble(shorter, few, objects), tmp_path / "parts")
    last = tmp_path / "parts" / "checkpoints" / f"step-{actions:08d}.safetensors"
    episode = load_archive(last, CHECKPOINT_KIND).meta["episode"]
    assert set(episode["teachers"]) == {"straight", "zigzag", "spiral"}
    # Environments of their own, as in another process.
    learn(longer, assemble(longer, few, objects), tmp_path / "parts", resume=True)
    end = "checkpoints/step-00000034.safetensors"
    for name in ("metrics.jsonl", "actor.safetensors", end):
        assert (tmp_path / "parts" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_rating_the_targets_of_held_out_heaps_changes_nothing_else(
    debug, heap_set, boxes, tmp_path
):
    rated = debug.changed(grasp_network="shipped")
    for name, config in (("rated", rated), ("plain", debug)):
        learn(config, assemble(config, heap_set, boxes), tmp_path / name)
    logs = {
        name: list(read_lines(tmp_path / name / "metrics.jsonl")) for name in ("rated", "plain")
    }
    added = {f"graspability_change{end}" for end in ("", "_ci_low", "_ci_high")}
    for ours, theirs in zip(logs["rated"], logs["plain"], strict=True):
        more = ours.keys() - theirs.keys()
        assert more == (added if ours["kind"] == "held_out" else set())
        same = ours.keys() & theirs.keys() - {"check"}
        assert {name: repr(ours[name]) for name in same} == {n: repr(theirs[n]) for n in same}
    actors = [(tmp_path / name / "actor.safetensors").read_bytes() for name in logs]
    assert load_policy(tmp_path / "rated").training_actions == debug.schedule.actions
    assert actors[0] == actors[1]


def test_a_grasp_network_that_is_not_there_is_refused(debug, heap_set, boxes, tmp_path):
    absent = debug.changed(grasp_network=str(tmp_path / "absent.safetensors"))
    with pytest.raises(MechSearchError, match=r"absent\.safetensors"):
        assemble(absent, heap_set, boxes)
