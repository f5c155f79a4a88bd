"""`mechsearch robot`."""

from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import tyro

from mechsearch.cli.command import FLAT, Command, bars, say, wrote
from mechsearch.robot import bags
from mechsearch.robot.controller import GRASP_FROM, Controller
from mechsearch.robot.grasper import open_grasper
from mechsearch.robot.limits import Limits, Motion
from mechsearch.robot.policy import open_policy
from mechsearch.robot.segmenter import open_segmenter
from mechsearch.types import MechSearchError


@dataclass(frozen=True)
class PlayBag(Command):
    """Play a recorded bag through the controller: what it would do, drawn, and as commands.

    Attributes:
        bag: Of ROS 2, in sqlite3 or MCAP.
        policy: What `mechsearch export policy` wrote.
        out: New folder for the pictures and the bag of commands.
        segmenter: What `mechsearch export segmenter` wrote: finds the target in the bag's colour
            images, so that it needs no masks.
        workspace: Where the middle of the table's workspace is in the base frame, and about its
            vertical axis how it is turned [m, m, m, degrees].
        low: Lowest corner of the box that the tool stays in, in the base frame [m].
        high: Highest corner [m].
        grasps: What `mechsearch export grasps` wrote: where a grasp is good enough, it takes the
            place of the push.
        grasp_from: Quality from which on a grasp is good enough, in [0, 1].
        speed: Of the tip [m/s].
        reach: How far the tip gets from the base's origin [m].
        seed: Of the policy's candidates.
        calibration: What `mechsearch robot calibrate` wrote; without it, the bag's transforms say
            where the camera is.
        topics: Where things are in the bag.
    """

    bag: Annotated[Path, tyro.conf.Positional]
    policy: Path
    out: Path
    workspace: tuple[float, float, float, float]
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    segmenter: Path | None = None
    grasps: Path | None = None
    grasp_from: float = GRASP_FROM
    speed: float = Limits.speed
    reach: float = Limits.reach
    seed: int = 0
    calibration: Path | None = None
    topics: Annotated[bags.Topics, FLAT] = field(default_factory=bags.Topics)

    def run(self) -> None:
        """Decide on every image, and write what comes of it."""
        if self.out.exists():
            raise MechSearchError(f"{self.out} is there already; expected a new folder")
        x, y, z, degrees = self.workspace
        c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
        pose = [[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1]]
        limits = Limits(self.low, self.high, self.speed, reach=self.reach, dry_run=True)
        rng = np.random.default_rng(self.seed)
        segmenter = None if self.segmenter is None else open_segmenter(self.segmenter)
        grasper = None if self.grasps is None else open_grasper(self.grasps)
        controller = Controller(
            open_policy(self.policy), pose, limits, rng, segmenter, grasper, self.grasp_from
        )
        self.out.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{self.out.name}.", dir=self.out.parent) as partial:
            self._play(controller, Path(partial, self.out.name))
            Path(partial, self.out.name).rename(self.out)
        wrote(self.out)

    def _play(self, controller: Controller, out: Path) -> None:
        out.mkdir()
        motions: list[Motion] = []
        lines: list[str] = []
        with bars() as progress:
            told = partial(progress, f"images of {self.bag.name}")
            masks = self.segmenter is None
            seen = bags.read_bag(self.bag, self.topics, self.calibration, told, masks)
            for frame, tool in seen:
                motions.append(motion := controller.step(frame, tool, frame.time))
                if len(motions) > 1 and (motion.goal == motions[-2].goal).all():
                    continue
                lines.append(_told(motion))
                drawn = replace(frame, mask=controller.mask)
                bags.draw(drawn, tool, motion).save(out / f"{len(motions):04d}.png")
        say("\n".join(lines))
        bags.write_commands(out / "commands", motions, self.topics.base, bags.is_mcap(self.bag))


def _told(motion: Motion) -> str:
    goal = ", ".join(f"{number:.3f}" for number in motion.goal)
    sure = "" if motion.confidence is None else f", confidence {motion.confidence:.2f}"
    if (grasp := motion.grasp) is not None:
        turn = np.rad2deg(np.arctan2(*grasp.axes[1::-1, 0]))
        goal += f") m, closing along {turn:.0f} degrees, from ("
        goal += ", ".join(f"{number:.3f}" for number in grasp.begin)
    return f"{motion.time:.3f} s  {motion.kind} to ({goal}) m{sure}: {motion.reason}"
