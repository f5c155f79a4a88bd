import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from mechsearch.objects.household.items import items
from mechsearch.objects.household.object_set import household, triangle_distances
from mechsearch.objects.household.primitives import MOST_CORNERS
from mechsearch.objects.meshes.prepare import why_wrong_mass, why_wrong_shape, why_wrong_size

MODELS = household().models
CATEGORIES = {"can", "box", "bottle", "bowl", "mug", "cup", "fruit", "ball", "tool", "clamp"}
CATEGORIES |= {"block", "cutlery"}

PUBLISHED = {  # Sides [mm] in ascending order, mass [g].
    "coffee_can": ((102, 102, 139), 414),
    "soup_can": ((66, 66, 101), 349),
    "tuna_can": ((33, 85, 85), 171),
    "chips_can": ((75, 75, 250), 205),
    "meat_can": ((50, 82, 97), 370),
    "cracker_box": ((60, 158, 210), 411),
    "sugar_box": ((38, 89, 175), 514),
    "pudding_box": ((35, 89, 110), 187),
    "gelatin_box": ((28, 73, 85), 97),
    "mustard_bottle": ((50, 85, 175), 603),
    "bleach_bottle": ((65, 98, 250), 1131),
    "bowl": ((53, 159, 159), 147),
    "cup_a": ((55, 55, 60), 13),
    "pear": ((66.2, 66.2, 100), 49),
    "strawberry": ((43.8, 43.8, 55), 18),
    "lemon": ((54, 54, 68), 29),
    "soccer_ball": ((140, 140, 140), 123),
    "golf_ball": ((42.7, 42.7, 42.7), 46),
    "small_clamp": ((10, 65, 85), 19.2),
    "extra_large_clamp": ((37, 165, 213), 202),
    "wood_block": ((85, 85, 200), 729),
    "foam_brick": ((50, 50, 75), 28),
    "cube_puzzle": ((57, 57, 57), 94),
}


def inside(model, point):
    planes = [ConvexHull(part).equations for part in model.parts]
    return any((p[:, :3] @ point + p[:, 3] <= 0).all() for p in planes)


def test_set_is_large_varied_and_wholly_usable():
    assert len(MODELS) >= 40
    assert {model.category for model in MODELS.values()} >= CATEGORIES
    assert not household().excluded
    assert [name for name, *_ in items()] == list(MODELS)


@pytest.mark.parametrize("name", PUBLISHED)
def test_sizes_and_masses_are_the_published_ones(name):
    sides, grams = PUBLISHED[name]
    model = MODELS[name]
    assert 1000 * np.sort(np.ptp(model.vertices, axis=0)) == pytest.approx(sides, abs=0.01)
    assert 1000 * model.mass == pytest.approx(grams)


@pytest.mark.parametrize("name", MODELS)
def test_object_can_lie_in_a_heap(name):
    model = MODELS[name]
    assert why_wrong_size(name, model.vertices) == ""
    assert why_wrong_shape(model.hull_error, "") == ""
    volume = sum(ConvexHull(part).volume for part in model.parts)
    assert why_wrong_mass(model.mass, volume) == ""


@pytest.mark.parametrize("name", MODELS)
def test_parts_are_few_and_small_enough_for_fast_physics(name):
    parts = MODELS[name].parts
    assert len(parts) <= 13
    assert max(map(len, parts)) <= MOST_CORNERS


def test_average_object_has_few_parts():
    assert np.mean([len(model.parts) for model in MODELS.values()]) < 6


def test_at_least_eight_objects_are_concave():
    def hollowness(model):
        return 1 - sum(ConvexHull(p).volume for p in model.parts) / (
            ConvexHull(model.vertices).volume
        )

    concave = [name for name, model in MODELS.items() if hollowness(model) > 0.25]
    assert len(concave) >= 8
    assert {"bowl", "mug", "cup_a", "scissors", "small_clamp", "wrench", "fork"} <= set(concave)


@pytest.mark.parametrize("name", MODELS)
def test_mass_properties_agree_with_another_library(name):
    model = MODELS[name]
    blank = np.zeros((0, 3), int)
    hulls = [trimesh.Trimesh(part, blank, process=False).convex_hull for part in model.parts]
    volumes = np.array([hull.volume for hull in hulls])
    centre = volumes @ [hull.center_mass for hull in hulls] / volumes.sum()
    assert centre == pytest.approx(0, abs=2e-6)
    inertia = np.zeros((3, 3))
    for hull in hulls:
        hull.density = model.mass / volumes.sum()
        c = hull.center_mass
        inertia += hull.moment_inertia + hull.mass * (c @ c * np.eye(3) - np.outer(c, c))
    assert np.allclose(model.inertia, inertia, rtol=1e-3, atol=1e-4 * np.trace(inertia))


@pytest.mark.parametrize("name", MODELS)
def test_inertia_is_that_of_a_real_body(name):
    moments = np.linalg.eigvalsh(MODELS[name].inertia)
    assert moments[0] > 0
    assert moments[0] + moments[1] > moments[2]


@pytest.mark.parametrize("name", MODELS)
def test_mesh_is_no_farther_from_the_parts_than_stated(name):
    model = MODELS[name]
    rng = np.random.default_rng(0)
    chosen = rng.integers(len(model.faces), size=150)
    weights = rng.dirichlet([1, 1, 1], 150)
    points = np.einsum("nc,ncd->nd", weights, model.vertices[model.faces[chosen]])
    surfaces = np.concatenate([part[ConvexHull(part).simplices] for part in model.parts])
    assert triangle_distances(points, surfaces).min(axis=1).max() <= model.hull_error + 1e-5
    assert model.hull_error < 0.003


@pytest.mark.parametrize("name", MODELS)
def test_mesh_encloses_the_volume_of_the_parts(name):
    model = MODELS[name]
    enclosed = np.linalg.det(model.vertices[model.faces]).sum() / 6
    assert enclosed == pytest.approx(sum(ConvexHull(p).volume for p in model.parts), rel=0.06)


def test_every_object_is_told_apart_by_its_digest():
    assert len({model.content_hash for model in MODELS.values()}) == len(MODELS)


def test_building_again_gives_the_same_objects():
    again = household.__wrapped__().models
    assert household() is household()
    for name, model in MODELS.items():
        assert again[name].content_hash == model.content_hash
        assert (again[name].texels == model.texels).all()


def test_mug_and_bowl_and_cups_can_be_filled():
    for name in ("bowl", "mug", "cup_a", "cup_i"):
        model = MODELS[name]
        low, high = model.vertices[:, 2].min(), model.vertices[:, 2].max()
        wall = [p for part in model.parts for p in part if p[2] > high - 1e-5]
        rim = np.mean(wall, axis=0)
        assert not inside(model, np.array([rim[0], rim[1], 0.7 * high + 0.3 * low]))
        assert inside(model, np.array([rim[0], rim[1], low + 0.001]))


def test_a_finger_goes_through_the_handle_of_the_mug():
    model = MODELS["mug"]
    right = model.vertices[:, 0].max()
    middle = (model.vertices[:, 2].max() + model.vertices[:, 2].min()) / 2
    assert inside(model, np.array([right - 0.003, 0.0, middle]))
    assert not inside(model, np.array([right - 0.020, 0.0, middle]))
