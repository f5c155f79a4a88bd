import pytest

from mechsearch.heaps.dataset import embedded_file, open_heaps
from mechsearch.render.renderer import Renderer


@pytest.fixture(scope="module")
def heap():
    heap_set, objects = open_heaps(embedded_file("single"), "household")
    heap = heap_set.heaps[0]
    return heap, Renderer([objects.models[name] for name in heap.objects])
