from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from mechsearch.pictures import canvas
from mechsearch.pictures.canvas import captioned, legible
from mechsearch.pictures.sheet import heap_sheet, object_sheet
from mechsearch.types import MechSearchError


def test_every_object_fills_its_tile(models) -> None:
    sheet = np.asarray(object_sheet(models, columns=4, size=64))
    rows, columns = 2, 4
    assert sheet.shape[1] == columns * (64 + 10) + 10
    height = (sheet.shape[0] - 10) // rows
    for i in range(len(models)):
        row, column = divmod(i, columns)
        top, left = 10 + row * height, 10 + column * 74
        drawn = (sheet[top : top + 64, left : left + 64] < 250).any(axis=2)
        extent = max(np.ptp(np.flatnonzero(drawn.any(axis=axis))) for axis in (0, 1))
        assert extent > 0.85 * 64
        assert not drawn[0].any()


def test_heaps_show_their_target_in_green(covered, models) -> None:
    sheet = np.asarray(heap_sheet([covered, covered], models, size=96)).astype(int)
    green = (sheet[..., 1] > sheet[..., 0] + 60) & (sheet[..., 1] > sheet[..., 2] + 60)
    halves = np.array_split(green, 2, axis=1)
    assert all(half.any() for half in halves)


def test_names_of_all_scripts_can_be_read() -> None:
    for name in ("Tasse à café", "чашка", "φλιτζάνι", "hrníček"):
        assert legible(name) == name
    assert legible("杯子 2") == r"\u676f\u5b50 2"

    def drawn(text: str) -> bytes:
        return captioned(Image.new("RGB", (120, 10)), text, text=14).tobytes()

    # Boxes, which stand for what a font lacks, are alike.
    assert len({drawn(text) for text in ("й", "é", "λ", "杯", "子")}) == 5
    assert drawn("杯") == drawn(r"\u676f")


def test_empty_and_foreign_heaps_are_refused(covered, models) -> None:
    with pytest.raises(MechSearchError, match="no object to draw"):
        object_sheet({})
    with pytest.raises(MechSearchError, match="no heap to draw"):
        heap_sheet([], models)
    with pytest.raises(MechSearchError, match="'teapot' of another set"):
        heap_sheet([replace(covered, objects=("teapot", "lid", "small0"))], models)


def test_without_matplotlib_a_caption_is_written_in_pillows_typeface(monkeypatch):
    for cached in (canvas._font, canvas._glyphs):
        cached.cache_clear()
    with monkeypatch.context() as bare:
        bare.setattr(canvas, "typeface", lambda: None)
        assert legible("Schüssel 杯") == r"Schüssel \u676f"
        drawn = captioned(Image.new("RGB", (60, 10), "white"), "fork", text=12)
        assert np.asarray(drawn)[10:].min() < 100
        for cached in (canvas._font, canvas._glyphs):
            cached.cache_clear()
