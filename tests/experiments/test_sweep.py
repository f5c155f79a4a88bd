from mechsearch.experiments.sweep import run_all


def run(config):
    if config < 0:
        raise ValueError(f"{config} diverges")
    return config * 10


def test_summaries_keep_the_order_and_a_run_that_fails_twice_is_named():
    told = []
    found = run_all(run, [3, -1, 2], progress=lambda *words: told.append(words))
    assert (found[0], found[2]) == (30, 20)
    assert found[1].reason == "worker raised: ValueError: -1 diverges"
    assert told == [("runs", 1, 3), ("runs", 2, 3), ("runs", 3, 3)]
