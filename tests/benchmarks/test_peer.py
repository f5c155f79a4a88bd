import numpy as np
import pytest

pytest.importorskip("pybullet", reason="the extra bullet is not installed")

from benchmarks.peer import PeerWorld
from benchmarks.peer_camera import PeerCamera
from benchmarks.workload import Workload
from mechsearch.camera import preset
from mechsearch.render.renderer import Renderer
from mechsearch.sim.scene import Pusher, pusher_model
from mechsearch.sim.world import World

CUBE = np.array([[0.0, 0.0, 0.03, 1.0, 0.0, 0.0, 0.0]])


@pytest.fixture(scope="module")
def workload():
    return Workload(None, "household")


@pytest.fixture(scope="module", params=[5, 15])
def scene(workload, request):
    """A heap in both stacks: our frame, and the peer's depth, ids, projection and occlusion."""
    heap = workload.heaps(request.param, 1)[0]
    models, camera, tip = workload.models(heap), preset("overhead"), np.array([0.2, -0.25, 0.1])
    ours = Renderer(models, pusher_model(Pusher())).frame(camera, heap.poses, Pusher().pose(tip))
    with PeerWorld(models) as world:
        world.reset(heap.poses, tip)
        view = PeerCamera(world, models, heap.target, camera)
        depth, ids = view.images()
        amodal = view.amodal()
        yield heap, ours, depth, ids, amodal, view.occlusion(ids, amodal)
        view.close()


def test_both_stacks_see_the_same_depth(scene):
    _, ours, depth, *_ = scene
    assert (np.abs(ours.depth - depth) < 0.002).mean() > 0.99


def test_both_stacks_see_the_same_objects_and_the_targets_whole_projection(scene):
    heap, ours, _, ids, amodal, _ = scene
    theirs = np.where((ids >= 0) & (ids < len(heap.objects)), ids, -1)
    assert (np.where(ours.ids >= 0, ours.ids, -1) == theirs).mean() > 0.99
    assert (ours.amodal[heap.target] == amodal).mean() > 0.99


def test_both_stacks_measure_the_same_occlusion_but_for_the_grain_of_the_image(scene):
    heap, *_, occlusion = scene
    assert occlusion == pytest.approx(heap.occlusion, abs=0.06)


def test_poses_are_returned_as_they_were_set(workload):
    heap = workload.heaps(10, 1)[0]
    with PeerWorld(workload.models(heap)) as world:
        world.reset(heap.poses)
        np.testing.assert_allclose(world.poses[:, :3], heap.poses[:, :3], atol=1e-6)
        cosines = np.abs((world.poses[:, 3:] * heap.poses[:, 3:]).sum(axis=1))
        np.testing.assert_allclose(cosines, 1.0, atol=1e-6)


@pytest.mark.parametrize("rigid", [False, True])
def test_a_push_of_12_cm_moves_a_cube_equally_far_in_both_stacks_within_1_cm(boxes, rigid):
    cube = [boxes.models["cube"]]
    ours, start = World(cube, pusher=Pusher()), np.array([-0.08, 0.0, 0.03])
    ours.reset(CUBE, start)
    with PeerWorld(cube, rigid=rigid) as peer:
        peer.reset(CUBE, start)
        for x in (-0.03, 0.02, 0.07):
            for world in (ours, peer):
                world.push(np.array([x, 0.0, 0.03]))
        assert peer.pusher_position == pytest.approx(ours.pusher_position, abs=0.002)
        assert ours.poses[0, 0] > 0.09
        assert peer.poses[0, :3] == pytest.approx(ours.poses[0, :3], abs=0.01)


def test_the_peers_pusher_keeps_to_its_command_in_free_air(boxes):
    with PeerWorld([boxes.models["cube"]]) as peer:
        aside = np.array([[0.3, 0.3, 0.03, 1.0, 0.0, 0.0, 0.0]])
        peer.reset(aside, np.array([0.0, 0.0, 0.1]))
        for offset in np.array([[0.05, 0, 0], [0, 0.03, -0.04], [-0.03, -0.03, 0.02]]):
            goal = peer.pusher_position + offset
            peer.displace(offset)
            assert peer.pusher_position == pytest.approx(goal, abs=0.001)


def test_heaps_at_rest_stay_within_bullets_margins(workload):
    moved = []
    for heap in workload.heaps(15, 5):
        with PeerWorld(workload.models(heap)) as world:
            world.reset(heap.poses)
            world.step(120)
            moved.append(np.linalg.norm(world.poses[:, :3] - heap.poses[:, :3], axis=1))
    assert np.median(np.concatenate(moved)) < 0.005
