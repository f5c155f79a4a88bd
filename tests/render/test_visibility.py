import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mechsearch.camera import preset
from mechsearch.render.body import body_of
from mechsearch.render.visibility import occlusion

CAMERA = preset("overhead")


def at(x, y, z):
    return [x, y, z, 1.0, 0.0, 0.0, 0.0]


def hidden(boxes, names, poses, target=0):
    return occlusion([body_of(boxes.models[n]) for n in names], CAMERA, np.array(poses), target)


def test_occlusion_is_zero_when_target_is_alone(boxes):
    assert hidden(boxes, ["cube"], [at(0.1, 0, 0.03)]) == 0.0


def test_occlusion_is_one_under_a_larger_plate(boxes):
    assert hidden(boxes, ["small0", "plate"], [at(0, 0, 0.015), at(0, 0, 0.04)]) == 1.0


def test_half_a_cover_hides_half(boxes):
    """Seen from 1 m, the edge of a plate 4 cm up lies over the middle of a cube 3 cm high."""
    measured = hidden(boxes, ["small0", "plate"], [at(0, 0, 0.015), at(0.05, 0, 0.04)])
    assert measured == pytest.approx(0.5, abs=0.04)


def test_an_object_below_hides_nothing(boxes):
    assert hidden(boxes, ["small0", "plate"], [at(0, 0, 0.06), at(0, 0, 0.01)]) == 0.0


def test_projection_beyond_the_frame_counts(boxes):
    """The cube's projection spans 0.333 to 0.374 m on the table, and the image ends at 0.348 m.

    The plate's outer edge, 5 cm up at 0.336 m, projects to the middle of that span: in the frame
    alone everything would be hidden, in truth half is.
    """
    poses = [at(0.348, 0, 0.015), at(0.286, 0, 0.04)]
    assert hidden(boxes, ["small0", "plate"], poses) == pytest.approx(0.5, abs=0.05)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_permuting_the_objects_changes_nothing(boxes, seed):
    rng = np.random.default_rng(seed)
    names = list(boxes.models)
    poses = np.array([at(*rng.uniform(-0.06, 0.06, 2), rng.uniform(0.02, 0.2)) for _ in names])
    order = rng.permutation(len(names))
    target = int(rng.integers(len(names)))
    before = hidden(boxes, names, poses, target)
    after = hidden(boxes, [names[i] for i in order], poses[order], int(np.argsort(order)[target]))
    assert before == after
    assert 0.0 <= before <= 1.0
