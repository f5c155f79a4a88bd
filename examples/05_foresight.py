"""How well can be foreseen what a push brings? Ask simulators that know a heap to some millimetres.

    python examples/05_foresight.py --decisions 40 --pushes 24 --copies 6

At the start of training heaps random pushes are tried in the simulator itself, and in copies of it
in which every object lies a little elsewhere. What is printed is how the copies rank the pushes,
and what the push that they choose really brings: one copy, and the mean of several.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import tyro

import mechsearch
from mechsearch.camera import preset
from mechsearch.env import HeapEnv, from_start, imageless, roll_out
from mechsearch.pushes.push import PlannedPush, draw_pushes, look


@dataclass(frozen=True)
class Options:
    """What is asked.

    Attributes:
        heaps: Heap set (.parquet); the embedded ones if empty.
        objects: Object set that the heaps were made with.
        decisions: Training heaps.
        pushes: To choose among in each.
        copies: Simulators that err.
        errors: By how much in x and y, each a standard deviation [m].
        later: What is expected after a push that leaves the target covered, and how much less where
            it is wholly hidden; here what followed the pushes of `plus`.
        seed: Of pushes and errors.
    """

    heaps: str = ""
    objects: str = "household"
    decisions: int = 3
    pushes: int = 4
    copies: int = 2
    errors: tuple[float, ...] = (0.001, 0.003)
    later: tuple[float, float] = (-8.7, 6.8)
    seed: int = 0


def outcomes(
    env: HeapEnv, twin: HeapEnv, options: Options, rng: np.random.Generator
) -> Iterator[np.ndarray]:
    """Yield what pushes bring (1 + errors * copies, pushes), the true ones first."""
    camera = preset(env.config.camera, env.config.image_size)
    for heap in np.linspace(0, len(env.heaps) - 1, options.decisions).astype(int):
        sight = look(env.reset(seed=options.seed, options={"heap": int(heap)})[0], camera)
        if sight.centre is None:
            continue
        start, pushes = from_start(env.snapshot()), draw_pushes(options.pushes, rng, True)
        copies = [0.0, *np.repeat(options.errors, options.copies)]
        rows = np.zeros((len(copies), len(pushes)))
        for row, error in zip(rows, copies, strict=True):
            twin.restore(start)
            lies = twin.world.poses
            lies[:, :2] += error * rng.standard_normal((len(lies), 2))
            for i, push in enumerate(pushes):
                obs = twin.restore(start)
                if error:
                    twin.world.reset(lies, sight.ee_position)
                    twin.world.step(150)
                done = roll_out(twin, obs, PlannedPush(push, sight).act)
                at_once, less = options.later
                later = at_once - less * min(done.occlusion, 1)
                row[i] = done.reward + (0 if done.end == "uncovered" else later)
        yield rows


def main() -> None:
    """Print how errors of position change what is chosen."""
    options = tyro.cli(Options)
    env = mechsearch.make_env(heaps=options.heaps or None, objects=options.objects)
    rng = np.random.default_rng(options.seed)
    found = np.array(list(outcomes(env, imageless(env), options, rng)))
    true, erring = found[:, 0], found[:, 1:]
    copies = erring.reshape(len(true), -1, options.copies, options.pushes)
    best = true.max(axis=1).mean()
    print(f"{len(true)} decisions: a push brings {true.mean():.1f}, the best {best:.1f}")
    for i, error in enumerate(options.errors):
        single = [said(copies[:, i, k], true) for k in range(options.copies)]
        for what, (rank, brought) in (
            ("one copy", np.mean(single, axis=0)),
            (f"mean of {options.copies}", said(copies[:, i].mean(axis=1), true)),
        ):
            print(f"{1e3 * error:.0f} mm, {what}: correlation {rank:.2f}, chosen {brought:.1f}")


def said(values: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Return the mean correlation within decisions, and what the pushes of best value bring."""
    varied = (np.ptp(values, axis=1) > 0) & (np.ptp(true, axis=1) > 0)
    pairs = zip(values[varied], true[varied], strict=True)
    rank = np.mean([np.corrcoef(*pair)[0, 1] for pair in pairs]) if varied.any() else np.nan
    return float(rank), float(true[np.arange(len(true)), values.argmax(axis=1)].mean())


if __name__ == "__main__":
    main()
