import importlib.util
from pathlib import Path

import pytest
from PIL import Image

from mechsearch.pictures.film import Film, FilmConfig, write_film
from mechsearch.types import MechSearchError


@pytest.fixture
def film(models, make_evaluation) -> Film:
    record = make_evaluation("method", 1.0).episodes[0]
    return Film(record, models, FilmConfig(size=81))


def test_a_gif_shows_every_state_once_and_the_last_one_longer(film: Film, tmp_path: Path) -> None:
    write_film(tmp_path / "a.gif", film, rate=5)
    with Image.open(tmp_path / "a.gif") as image:
        durations = []
        for i in range(image.n_frames):
            image.seek(i)
            durations.append(image.info["duration"])
    assert sum(durations) == 200 * 9 + 1000
    assert durations[-1] >= 1200


def test_an_mp4_of_an_odd_size_is_written(film: Film, tmp_path: Path) -> None:
    reader = pytest.importorskip("imageio_ffmpeg").read_frames
    write_film(tmp_path / "a.mp4", film, rate=5)
    facts = next(reader(str(tmp_path / "a.mp4")))
    assert facts["size"][0] == 80
    assert facts["duration"] == pytest.approx((9 + 5) / 5, abs=0.3)


def test_bad_requests_are_refused_and_leave_nothing(
    film: Film, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(MechSearchError, match=r"unknown format '\.avi'; choose one of \.gif"):
        write_film(tmp_path / "a.avi", film)
    with pytest.raises(MechSearchError, match=r"expected 0\.01 to 100"):
        write_film(tmp_path / "a.gif", film, rate=0)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MechSearchError, match=r"pip install '\.\[video\]'"):
        write_film(tmp_path / "a.mp4", film)
    assert list(tmp_path.iterdir()) == []
