import numpy as np
from PIL import Image

from mechsearch.camera import Camera, look_at
from mechsearch.grippers import GraspView, ImageGrasp
from mechsearch.pictures.canvas import tiled
from mechsearch.pictures.grasps import draw_grasps


def test_the_best_grasp_is_drawn_where_it_closes():
    pose = look_at((0, 0, 0.8), (0, 0, 0), (0, 1, 0))
    overhead = Camera(160, 120, 552.5, 552.5, 79.5, 59.5, pose)
    depth = np.full((120, 160), 0.8, np.float32)
    mask = np.zeros(depth.shape, np.bool_)
    mask[50:70, 70:90] = True
    view = GraspView(depth, mask, overhead, 0.8)
    empty = np.asarray(draw_grasps(view, [], "none", size=240)).astype(int)
    grasp = ImageGrasp(60.0, 80.0, 0.8, 0.0, 1.0)
    drawn = np.asarray(draw_grasps(view, [grasp], "none", size=240)).astype(int)
    rows, columns = np.nonzero(np.abs(drawn - empty).sum(axis=2)[:240])
    # 56 mm at 0.8 m are 38.7 of the 79 px shown; so 117 of 240.
    assert abs(np.ptp(columns) - 117) < 8
    assert abs(rows.mean() - 240 * (60.5 - 20) / 79) < 3
    blue = drawn[int(rows.mean()), int(columns.mean())]
    assert blue[2] > blue[0] + 100


def test_pictures_are_put_together():
    tiles = [Image.new("RGB", (10, 20)) for _ in range(5)]
    assert tiled(tiles, 4, margin=3).size == (64, 52)
    assert tiled([tiles[0], Image.new("RGB", (30, 5))], 1, gap=0).size == (30, 25)
    assert tiled([tiles[0], Image.new("RGB", (30, 5))], 2, gap=4).size == (44, 20)
