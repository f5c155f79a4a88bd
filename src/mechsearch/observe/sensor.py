"""What a depth camera, its calibration and a segmentation get wrong, between renderer and policy.

Where numbers come from, by the names used below:

- Grunnet-Jepsen, Sweetser and Woodfill, "Tuning depth cameras for best performance", Intel: the
  error of a D4xx is distance^2 x subpixel / (focal length x baseline), with 848 px over 90 degrees
  and 50 mm of a D435.
- Grunnet-Jepsen et al., "Subpixel linearity improvement for Intel RealSense depth camera D400
  series": disparities come in steps of 1/32 px.
- Intel RealSense D400 series data sheet: Z accuracy within 2 % up to 2 m.
- Azure Kinect DK hardware specification, confirmed by Toelgyessy et al., "Evaluation of the Azure
  Kinect and its comparison to Kinect v1 and Kinect v2", Sensors 21(2), 413, 2021, and compared with
  a laser scanner by Kurillo et al., "Evaluating the accuracy of the Azure Kinect and Kinect v2",
  Sensors 22(7), 2469, 2022: standard deviation up to 17 mm and distance error below 11 mm, up to
  3.5 m; 640 px over 75 degrees, 0.5 to 3.86 m.

All other numbers are choices; `docs/sensors.md` says which.
"""

from dataclasses import dataclass, fields, replace
from functools import cached_property
from math import cos, inf, radians, tan
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import (
    distance_transform_edt,
    find_objects,
    gaussian_filter,
    maximum_filter,
    minimum_filter,
)

from mechsearch.camera import Camera, edge_step
from mechsearch.types import Array, Floats, MechSearchError

_NOTHING = 1e3
"""Depth where nothing is [m], for differences of neighbours."""

_BRIGHTNESS = np.array([0.299, 0.587, 0.114])


@dataclass(frozen=True)
class Sensor:
    """What is wrong with what is seen; by default nothing.

    Lengths in pixels are those of the sensor's own image, and mean as much of the scene in an image
    of another size. Shares and chances are in [0, 1]. Standard deviations are for short "std".

    Attributes:
        focal: Focal length of the sensor's own image [px].
        baseline: From the imager that the image is of to a second one on its right [m], which must
            see a point too; 0 for a sensor of one imager.
        inverse_noise: Std of one over depth [1/m]: that of depth is so much times its square. It
            grows with one over the cosine between surface normal and ray.
        inverse_step: One over depth comes in steps of this [1/m].
        depth_step: Depth comes in steps of this [m].
        correlation: Std of the window over which noise is alike [px].
        offset_error: Std of an offset of all depths of an episode [m].
        scale_error: Std of the relative error of all depths of an episode.
        nearest: Least depth [m].
        farthest: Greatest depth [m].
        grazing: Greatest angle between normal and ray [degrees].
        edge_width: Of the band at an edge of depth that the two following are about [px].
        edge_holes: Share of it where nothing is measured.
        flying: Share of it that is measured between the two surfaces.
        dark: Brightness, from 0 to 255, below which a surface is dark.
        dark_holes: Share of dark surfaces where nothing is measured.
        glossy: Share of objects that mirror; the renderer knows colours, but no gloss.
        mirroring: Angle between normal and ray within which these dazzle the sensor [degrees].
        patches: Mean number of lost patches in an image.
        patch_radius: Theirs in the mean [px].
        camera_shift: Std of the camera's place along each axis [m].
        camera_turn: Std of its rotation about each axis [degrees].
        effector_error: Std of the reported end effector along each axis [m], the same for all of an
            episode.
        mask_inset: How far a mask's border lies inwards in all images [px].
        mask_shift: Std of how far it is moved outwards in an image [px].
        mask_waves: Std of how far it moves beside that from place to place [px].
        mask_missing: Chance that a part of a mask is missing.
        mask_false: Chance that a part beside it is wrongly in it.
        mask_part: Radius of such parts, and length of the waves [px].
    """

    focal: float = 424.0
    baseline: float = 0.0
    inverse_noise: float = 0.0
    inverse_step: float = 0.0
    depth_step: float = 0.0
    correlation: float = 0.0
    offset_error: float = 0.0
    scale_error: float = 0.0
    nearest: float = 0.0
    farthest: float = np.inf
    grazing: float = 90.0
    edge_width: float = 0.0
    edge_holes: float = 0.0
    flying: float = 0.0
    dark: float = 0.0
    dark_holes: float = 0.0
    glossy: float = 0.0
    mirroring: float = 0.0
    patches: float = 0.0
    patch_radius: float = 0.0
    camera_shift: float = 0.0
    camera_turn: float = 0.0
    effector_error: float = 0.0
    mask_inset: float = 0.0
    mask_shift: float = 0.0
    mask_waves: float = 0.0
    mask_missing: float = 0.0
    mask_false: float = 0.0
    mask_part: float = 0.0

    @cached_property
    def is_perfect(self) -> bool:
        """Whether nothing is wrong: images are then passed on as they are."""
        return self == Sensor()

    @property
    def reads_colour(self) -> bool:
        """Whether what is measured depends on colours."""
        return self.dark_holes > 0

    def measure(
        self,
        depth: Array,
        camera: Camera,
        rng: np.random.Generator,
        colour: Array | None = None,
        glossy: Array | None = None,
        systematic: tuple[float, float] = (1.0, 0.0),
    ) -> Array:
        """Return a depth image as it is measured.

        Args:
            depth: True depth (H, W) [m]; 0 where nothing is.
            camera: From which it is seen.
            rng: Draws the noise.
            colour: What is seen (H, W, 3) uint8, if `reads_colour`.
            glossy: Where objects mirror (H, W) bool; nowhere by default.
            systematic: Factor and offset [m] of all depths.

        Returns:
            Depth (H, W) float32 [m], 0 in holes; the very same array of a perfect sensor.
        """
        if self.is_perfect:
            return depth
        true = np.where(depth > 0, depth, _NOTHING).astype(np.float64)
        scale = camera.fx / self.focal
        facing = cosines(true, camera)
        band, edge = self._edges(true, camera)
        holes = ~(depth > 0)
        if self.grazing < 90:
            holes |= facing < cos(radians(self.grazing))
        if self.baseline:
            holes |= _unseen_from_the_right(true, camera, self.baseline, edge, rng)
        if self.edge_holes:
            holes |= band & _lost(rng, true.shape, self.edge_holes, self.correlation * scale / 2)
        if self.dark_holes and colour is not None:
            is_dark = colour @ _BRIGHTNESS < self.dark
            holes |= is_dark & _lost(rng, true.shape, self.dark_holes, 2 * self.correlation * scale)
        if self.mirroring and glossy is not None:
            holes |= glossy & (facing > cos(radians(self.mirroring)))
        for _ in range(rng.poisson(self.patches)):
            holes |= _disc(true.shape, rng.random(2) * true.shape, self.patch_radius * scale, rng)
        measured = self._fly(true, band, rng) if self.flying else true
        measured = measured * systematic[0] + systematic[1]
        noise = self.inverse_noise * _field(rng, true.shape, self.correlation * scale)
        inverse = _stepped(1 / measured + noise / np.maximum(facing, 0.1), self.inverse_step)
        found = _stepped(1 / np.where(inverse > 0, inverse, np.inf), self.depth_step)
        holes |= ~((found > 0) & (found >= self.nearest) & (found <= self.farthest))
        return np.where(holes, 0, found).astype(np.float32)

    def segment(self, labels: Array, camera: Camera, rng: np.random.Generator) -> Array:
        """Return a mask, or an image of numbered masks, as a segmentation gives it.

        Where masks grow into each other, the one of the lower number prevails.

        Args:
            labels: (H, W) bool, or whole numbers of which 0 is no mask.
            camera: From which it is seen.
            rng: Draws the errors.

        Returns:
            The like; the very same array where masks have no errors.
        """
        errors = self.mask_inset, self.mask_shift, self.mask_waves, self.mask_missing
        if not (any(errors) or self.mask_false):
            return labels
        numbers = labels.astype(np.uint8)
        found, scale = np.zeros_like(numbers), camera.fx / self.focal
        part = self.mask_part * scale
        reach = int(np.ceil(2 * part + 4 * (self.mask_shift + self.mask_waves) * scale)) + 1
        for number, box in enumerate(find_objects(numbers), start=1):
            if box is None:
                continue
            where = tuple(slice(max(s.start - reach, 0), s.stop + reach) for s in box)
            mask = self._mask(numbers[where] == number, scale, part, rng)
            found[where][mask & (found[where] == 0)] = number
        return found.astype(labels.dtype)

    def episode(self, seed: tuple[int, ...], objects: int) -> "Sensing":
        """Return the sensor in an episode, which depends on these alone.

        Args:
            seed: Whole numbers, none below 0.
            objects: How many there are.
        """
        return Sensing(self, seed, objects)

    def _edges(self, depth: Floats, camera: Camera) -> tuple[Array, Array]:
        """Return the band at edges of depth, thinned where it is narrower than a pixel, and edges.

        An edge is a pixel that differs from a neighbour by more than the steepest surface would.
        """
        step = edge_step(depth, camera)
        low, high = minimum_filter(depth, footprint=_CROSS), maximum_filter(depth, footprint=_CROSS)
        edge: Array = (depth - low > step) | (high - depth > step)
        width = self.edge_width * camera.fx / self.focal
        if not width:
            return np.zeros_like(edge), edge
        # Half of the band is on either side, and the edge's own pixels are the innermost.
        band = distance_transform_edt(~edge) < max(width / 2, 1.0)
        return band, edge

    def _fly(self, depth: Floats, band: Array, rng: np.random.Generator) -> Floats:
        """Return depth some of whose pixels in a band are between the surfaces around them."""
        low, high = minimum_filter(depth, 3), maximum_filter(depth, 3)
        other = np.where(high - depth > depth - low, high, low)
        between = depth + rng.random(depth.shape) * (other - depth)
        flies = band & (rng.random(depth.shape) < self.flying)
        return np.where(flies, between, depth)

    def _mask(self, mask: Array, scale: float, part: float, rng: np.random.Generator) -> Array:
        """Return one mask with errors, on a cutout that has room for them."""
        inside, outside = distance_transform_edt(mask), distance_transform_edt(~mask)
        # How far inside the border a pixel's centre is; negative outside.
        depth = np.where(mask, inside - 0.5, 0.5 - outside)
        waves = self.mask_waves * _field(rng, mask.shape, part) if self.mask_waves else 0.0
        outwards = self.mask_shift * rng.standard_normal() - self.mask_inset + waves
        moved: Array = depth + scale * outwards > 0
        pixels = np.argwhere(mask)
        if rng.random() < self.mask_missing:
            moved &= ~_disc(mask.shape, rng.choice(pixels), part, rng)
        beside = np.argwhere((outside > 0) & (outside <= max(part, 1.0)))
        if rng.random() < self.mask_false and len(beside):
            moved |= _disc(mask.shape, rng.choice(beside), part, rng)
        return moved


@dataclass(frozen=True)
class SensorMixture:
    """Another sensor in each episode, for policies that are to bear all of them.

    Attributes:
        sensors: Of which each is as likely.
    """

    sensors: tuple[Sensor, ...]

    @property
    def is_perfect(self) -> bool:
        """Whether nothing is ever wrong."""
        return all(sensor.is_perfect for sensor in self.sensors)

    def episode(self, seed: tuple[int, ...], objects: int) -> "Sensing":
        """Return the sensor in an episode; see `Sensor.episode`."""
        # A number more: the choice is not to go with the errors that the seed draws.
        chosen = np.random.default_rng((*seed, 0)).integers(len(self.sensors))
        return self.sensors[chosen].episode(seed, objects)


_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.bool_)


class Sensing:
    """A sensor in one episode: what is wrong all along, and what is measured at each step.

    Attributes:
        is_perfect: Whether nothing is wrong.
        reads_colour: Whether colours must be rendered.
    """

    def __init__(self, sensor: Sensor, seed: tuple[int, ...], objects: int) -> None:
        """Draw what is wrong all along; see `Sensor.episode`."""
        self._sensor, self._seed = sensor, seed
        self.is_perfect, self.reads_colour = sensor.is_perfect, sensor.reads_colour
        rng = np.random.default_rng(seed)
        self._shift = sensor.camera_shift * rng.standard_normal(3)
        self._turn = np.deg2rad(sensor.camera_turn) * rng.standard_normal(3)
        self._effector = sensor.effector_error * rng.standard_normal(3)
        offset = sensor.offset_error * rng.standard_normal()
        self._systematic = 1 + sensor.scale_error * rng.standard_normal(), offset
        # The last is of all that is no object: the table, the floor, the end effector.
        self._glossy = np.append(rng.random(objects) < sensor.glossy, False)

    def camera(self, camera: Camera) -> Camera:
        """Return where a camera really is that is believed to be somewhere."""
        if not (self._shift.any() or self._turn.any()):
            return camera
        pose, angle = camera.pose, float(np.linalg.norm(self._turn))
        x, y, z = self._turn / (angle or 1.0)
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
        pose[:3, 3] += pose[:3, :3] @ self._shift
        pose[:3, :3] = pose[:3, :3] @ turn
        return replace(camera, world_from_camera=tuple(pose.ravel().tolist()))

    def effector(self, position: Floats) -> Floats:
        """Return the position (3,) [m] that is reported of an end effector."""
        return position if self.is_perfect else position + self._effector

    def take(
        self,
        step: int,
        camera: Camera,
        depth: Array,
        labels: Array,
        ids: Array,
        colour: Array | None = None,
    ) -> tuple[Array, Array]:
        """Return depth and masks as they are measured at one step.

        Args:
            step: Number of actions so far.
            camera: From which all is really seen, see `camera`.
            depth: True depth (H, W) [m].
            labels: True masks; see `Sensor.segment`.
            ids: Object of each pixel (H, W); below 0 where there is none.
            colour: (H, W, 3), if `reads_colour`.
        """
        rng = np.random.default_rng((*self._seed, step, camera.height))
        glossy = self._glossy[np.maximum(ids, -1)]
        found = self._sensor.measure(depth, camera, rng, colour, glossy, self._systematic)
        return found, self._sensor.segment(labels, camera, rng)


def cosines(depth: Floats, camera: Camera) -> Floats:
    """Return the cosine between surface normal and ray at each pixel (H, W) of a depth image [m].

    At an edge it is that of the flatter side.
    """
    inverse = 1 / depth
    # One over depth is linear in the image of a plane.
    across = _slope(inverse, 1) * camera.fx
    down = _slope(inverse, 0) * camera.fy
    x, y, _ = np.moveaxis(camera.directions(), -1, 0)
    along = inverse - x * across - y * down
    length = np.sqrt((across**2 + down**2 + along**2) * (x**2 + y**2 + 1))
    facing: Floats = np.divide(inverse, length, out=np.ones_like(length), where=length > 0)
    return facing


def _slope(values: Floats, axis: int) -> Floats:
    """Return the smaller of the differences to the neighbours before and after along an axis."""
    steps = np.diff(values, axis=axis)
    edge = np.full_like(np.take(values, [0], axis), np.inf)
    before = np.concatenate([edge, steps], axis)
    after = np.concatenate([steps, edge], axis)
    smaller = np.where(np.abs(before) < np.abs(after), before, after)
    return np.where(np.isfinite(smaller), smaller, 0.0)


def _unseen_from_the_right(
    depth: Floats, camera: Camera, baseline: float, edge: Array, rng: np.random.Generator
) -> Array:
    """Return which pixels (H, W) a second imager on the right does not see.

    These are the ones that in its image are not left of all that is on their right. At edges, what
    is hidden of a pixel is its chance.
    """
    columns = np.arange(depth.shape[1]) - camera.fx * baseline / depth
    beyond = np.minimum.accumulate(columns[:, ::-1], axis=1)[:, ::-1]
    gap = np.full_like(depth, 1.0)
    gap[:, :-1] = beyond[:, 1:] - columns[:, :-1]
    return (gap <= 0) | (edge & (gap < rng.random(depth.shape)))


def _stepped(values: Floats, step: float) -> Floats:
    return np.round(values / step) * step if step else values


def _field(rng: np.random.Generator, shape: tuple[int, ...], length: float) -> Floats:
    """Return normal noise of variance 1 that is alike over a length, the std of a window [px]."""
    noise = rng.standard_normal(shape)
    if length < 0.3:
        return noise
    reach = int(3 * length + 0.5)
    window = np.exp(-0.5 * (np.arange(-reach, reach + 1) / length) ** 2)
    power = float((window**2).sum() / window.sum() ** 2)
    return np.asarray(gaussian_filter(noise, length, mode="wrap", truncate=3.0)) / power


def _lost(
    rng: np.random.Generator, shape: tuple[int, ...], share: float, length: float
) -> NDArray[np.bool_]:
    """Return a share of an image (H, W), in spots of about a length [px]."""
    bound = NormalDist().inv_cdf(share) if share < 1 else np.inf
    return _field(rng, shape, length) < bound


def _disc(shape: tuple[int, ...], centre: Array, radius: float, rng: np.random.Generator) -> Array:
    """Return a disc (H, W) whose radius [px] is drawn from half to one and a half of another."""
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    radius *= rng.uniform(0.5, 1.5)
    disc: NDArray[np.bool_] = np.hypot(rows - centre[0], columns - centre[1]) <= radius
    return disc


def _of_stereo(subpixel: float, focal: float, baseline: float) -> dict[str, float]:
    """Return what disparities [px] of a D4xx come to."""
    return {
        "focal": focal, "baseline": baseline, "inverse_noise": subpixel / (focal * baseline),
        "inverse_step": 1 / 32 / (focal * baseline),
    }  # fmt: skip


_D435 = 848 / 2 / tan(radians(45)), 0.05

_EACH = {
    "perfect": Sensor(),
    "stereo": Sensor(
        **_of_stereo(0.08, *_D435), depth_step=0.001, correlation=3.0, scale_error=0.02 / 3,
        nearest=0.2, farthest=6.0, grazing=80.0, edge_width=4.0, edge_holes=0.4, flying=0.2,
        dark=35.0, dark_holes=0.4, glossy=0.15, mirroring=5.0, patches=0.3, patch_radius=12.0,
        camera_shift=0.002, camera_turn=0.3, effector_error=0.001,
        mask_shift=2.0, mask_waves=2.0, mask_missing=0.05, mask_false=0.05, mask_part=12.0,
    ),
    "time-of-flight": Sensor(
        focal=640 / 2 / tan(radians(37.5)), inverse_noise=0.017 / 3.5**2, depth_step=0.001,
        correlation=1.0, offset_error=0.011 / 3, scale_error=0.001 / 3, nearest=0.5, farthest=3.86,
        grazing=85.0, edge_width=4.0, edge_holes=0.2, flying=0.6, dark=25.0, dark_holes=0.5,
        glossy=0.15, mirroring=3.0, patches=0.1, patch_radius=10.0,
        camera_shift=0.002, camera_turn=0.3, effector_error=0.001,
        mask_shift=2.0, mask_waves=2.0, mask_missing=0.05, mask_false=0.05, mask_part=12.0,
    ),
    "harsh": Sensor(
        **_of_stereo(0.25, *_D435), depth_step=0.001, correlation=3.0, scale_error=0.01,
        nearest=0.2, farthest=6.0, grazing=70.0, edge_width=8.0, edge_holes=0.6, flying=0.3,
        dark=60.0, dark_holes=0.7, glossy=0.4, mirroring=8.0, patches=1.5, patch_radius=25.0,
        camera_shift=0.005, camera_turn=1.0, effector_error=0.003,
        mask_shift=4.0, mask_waves=4.0, mask_missing=0.2, mask_false=0.2, mask_part=20.0,
    ),
}  # fmt: skip

SENSORS: dict[str, Sensor | SensorMixture] = {
    **_EACH, "mixed": SensorMixture(tuple(_EACH.values()))
}  # fmt: skip
"""Sensors by name: `perfect`, `stereo` (a RealSense D435), `time-of-flight` (an Azure Kinect in
narrow view, unbinned), `harsh` (a stereo camera, badly tuned and calibrated), and `mixed`: one of
these, another in each episode."""


def sensor_named(text: str) -> Sensor | SensorMixture:
    """Return a sensor by its name, and what of it is otherwise, such as "stereo camera_turn=1".

    Raises:
        MechSearchError: If there is none of that name, or it has no such attribute or value.
    """
    name, *changes = text.split() or [""]
    if name not in SENSORS:
        raise MechSearchError(
            f"unknown sensor {name!r}; choose one of {', '.join(SENSORS)}, and what of it is "
            'otherwise, such as "stereo camera_turn=1"'
        )
    sensor = SENSORS[name]
    if not changes:
        return sensor
    if not isinstance(sensor, Sensor):
        raise MechSearchError(f"sensor {text!r}: nothing of a mixture is otherwise")
    known = [field.name for field in fields(Sensor)]
    changed: dict[str, float] = {}
    for change in changes:
        attribute, _, value = change.partition("=")
        if attribute not in known:
            raise MechSearchError(
                f"sensor {text!r} is otherwise in {attribute!r}; choose one of {', '.join(known)}"
            )
        try:
            changed[attribute] = float(value)
        except ValueError:
            changed[attribute] = -1.0
        most = 1.0 if attribute in _SHARES else inf
        if not 0 <= changed[attribute] <= most:
            raise MechSearchError(
                f"sensor {text!r}: {attribute} is {value!r}; expected a number from 0"
                + (" to 1" if most == 1 else "")
            )
    return replace(sensor, **changed)


_SHARES = (
    "edge_holes", "flying", "dark_holes", "glossy", "mask_missing", "mask_false",
)  # fmt: skip
