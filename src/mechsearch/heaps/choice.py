"""Which heaps to take where some of them are enough."""


def evenly_spread(count: int, chosen: int) -> list[int]:
    """Return `chosen` of the indices below `count`, evenly spread.

    Heaps are kept by object count, so an even spread has all counts alike.
    """
    return [i * count // chosen for i in range(chosen)]
