from pathlib import Path

import pytest

from mechsearch.segmentation.images import ImageConfig, see_heaps


@pytest.fixture(scope="session")
def seen():
    """Images of the embedded heaps, by a perfect sensor."""
    config = ImageConfig(1, "all", 6, ("perfect",), randomised=False, also=(), variants=0)
    return see_heaps(Path("household-single"), "", config)
