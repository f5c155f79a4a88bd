import numpy as np
import pytest

NETWORKS = 2


@pytest.fixture(scope="session")
def pushes():
    """A small policy of pushes that has learnt nothing."""
    torch = pytest.importorskip("torch")
    from mechsearch.push_values.policy import PushPolicy, PushPolicyConfig
    from mechsearch.push_values.value import Continuation, PushValue, PushValueConfig

    torch.manual_seed(0)
    config = PushValueConfig(filters=4, hidden=(16, 8))
    networks = [PushValue(config) for _ in range(NETWORKS)]
    return PushPolicy(
        networks, Continuation(), PushPolicyConfig(candidates=24, searches=True, full_steps=True)
    )


@pytest.fixture(scope="session")
def actor():
    """An actor that has learnt nothing, and is sure of it."""
    torch = pytest.importorskip("torch")
    from mechsearch.actor_critic.networks import Actor, NetworkConfig
    from mechsearch.actor_critic.policy import ActorPolicy

    torch.manual_seed(0)
    shapes = {"depth": (1, 64, 64), "position_image": (3, 64, 64), "ee_position": (3,)}
    config = NetworkConfig(directions=True, lengths=True, centroid=True, output_bound=0.5)
    return ActorPolicy(Actor(shapes, config))


def exported(policy, algorithm, folder):
    """Write a policy as a run does, and export it by the command."""
    for module in ("onnx", "onnxscript", "onnxruntime"):
        pytest.importorskip(module)
    from mechsearch.cli import main
    from mechsearch.env import TaskConfig
    from mechsearch.training.run_directory import save_policy, trained

    file = folder / "policy.safetensors"
    save_policy(trained(policy, algorithm, 7, TaskConfig()), file)
    main(["export", "policy", str(file), "--out", str(folder / "exported")])
    return folder / "exported"


@pytest.fixture(scope="session")
def exported_pushes(pushes, tmp_path_factory):
    from mechsearch.push_values.algorithm import PushValues

    return exported(pushes, PushValues(), tmp_path_factory.mktemp("pushes"))


@pytest.fixture(scope="session")
def exported_actor(actor, tmp_path_factory):
    from mechsearch.actor_critic.algorithm import ActorCritic

    return exported(actor, ActorCritic(), tmp_path_factory.mktemp("actor"))


@pytest.fixture(scope="session")
def exported_segmenter(tmp_path_factory):
    """The shipped network, told of the target of `SimulatedRobot` by a file of its views."""
    for module in ("torch", "onnx", "onnxscript", "onnxruntime"):
        pytest.importorskip(module)
    from mechsearch.cli import main
    from mechsearch.segmentation.photographs import save_references
    from mechsearch.segmentation.reference import render_references
    from tests.robot.simulated_robot import SEEN_HEAP, SimulatedRobot

    place = tmp_path_factory.mktemp("segmenter")
    save_references(place / "views.npz", render_references(SimulatedRobot(SEEN_HEAP).target))
    words = f"export segmenter shipped --reference {place / 'views.npz'} --out {place / 'carried'}"
    main(words.split())
    return place / "carried"


@pytest.fixture(scope="session")
def exported_grasps(tmp_path_factory):
    """The shipped networks of jaws and of a cup, by gripper."""
    for module in ("torch", "onnx", "onnxscript", "onnxruntime"):
        pytest.importorskip(module)
    from mechsearch.cli import main

    place = tmp_path_factory.mktemp("grasps")
    for gripper in ("jaws-85", "suction"):
        main(["export", "grasps", gripper, "--out", str(place / gripper)])
    return place


@pytest.fixture(scope="session")
def observations():
    """What is seen in some episodes."""
    import mechsearch

    env, rng, seen = mechsearch.make_env(condition="single"), np.random.default_rng(0), []
    for seed in range(3):
        seen.append(env.reset(seed=seed)[0])
        seen += [env.step(rng.uniform(-1, 1, 3).astype(np.float32))[0] for _ in range(4)]
    return seen
