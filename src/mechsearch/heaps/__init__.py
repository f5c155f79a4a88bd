"""Start states: generate heaps, choose their targets, keep them in sets."""

from mechsearch.heaps.dataset import (
    CONDITIONS,
    Heap,
    HeapSet,
    check_objects,
    embedded_file,
    evenly_spread,
    load_heaps,
    object_set,
    objects_of,
    open_heaps,
    recorded_objects,
)
from mechsearch.heaps.generate import (
    GenerateConfig,
    generate,
    verify,
)
