"""Makes tests/corpus/images anew: one scene, stored in the ways that people store images.

A table 0.8 m below a camera of fx = fy = 552.5, the target a block at 0.76 m, another beside it.

python tests/corpus/make_images.py
"""

import struct
import zlib
from pathlib import Path

import numpy as np
from PIL import Image

FOLDER = Path(__file__).parent / "images"
K = np.array([[552.5, 0, 159.5], [0, 552.5, 119.5], [0, 0, 1]])


def scene():
    """Return the depth image (240, 320) float32 [m] and where the target is in it."""
    depth = np.full((240, 320), 0.8, np.float32)
    depth[100:130, 120:190] = 0.76
    depth[150:200, 60:90] = 0.74
    return depth, depth == np.float32(0.76)


def write_deep_colour(path, colours):
    """Write colours (H, W, 3) uint16 as PNG, which Pillow does not."""

    def chunk(kind, body):
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    height, width, _ = colours.shape
    header = struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in colours)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)


def palette(indices, colours):
    """Return a picture of indices (H, W) into colours."""
    picture = Image.new("P", indices.shape[::-1])
    picture.putdata(indices.ravel().tolist())
    picture.putpalette([level for colour in colours for level in colour])
    return picture


def main():
    """Write all of them."""
    depth, target = scene()
    millimetres = np.round(depth * 1000).astype(np.uint16)
    white = Image.fromarray(np.where(target, 255, 0).astype(np.uint8))
    full, black = Image.new("L", white.size, 255), Image.new("L", white.size, 0)
    labels = (target + 2 * (depth == np.float32(0.74))).astype(np.uint8)
    eight = Image.fromarray((millimetres // 10).astype(np.uint8))
    colours = np.random.default_rng(0).integers(0, 16, (30, 70, 3)) * 16
    photograph = np.full((*depth.shape, 4), (90, 120, 60, 0), np.uint8)
    photograph[target] = np.concatenate([colours, np.full((30, 70, 1), 255)], -1).reshape(-1, 4)
    black_red = palette(target, [(0, 0, 0), (200, 0, 0)])
    pictures = {
        "depth_16_bits.png": Image.fromarray(millimetres),
        "depth_float.tif": Image.fromarray(depth),
        "depth_8_bits.png": eight,
        "depth_8_bits.jpg": eight,
        "depth_palette.png": palette(millimetres // 10, [(i, i // 2, 90) for i in range(256)]),
        "depth_colour.png": Image.merge("RGB", [eight] * 3),
        "mask_white.png": white,
        "mask_ones.png": Image.fromarray(target.astype(np.uint8)),
        "mask_bilevel.png": white.convert("1"),
        "mask_16_bits.png": Image.fromarray(np.where(target, 65535, 0).astype(np.uint16)),
        "mask_inverted_palette.png": palette(~target, [(255, 255, 255), (0, 0, 0)]),
        "mask_red_palette.png": black_red,
        "mask_colour.png": Image.merge("RGB", [white, black, white]),
        "mask_alpha_of_white.png": Image.merge("RGBA", [full, full, full, white]),
        "mask_alpha_of_black.png": Image.merge("LA", [black, white]),
        "mask_opaque.png": Image.merge("RGBA", [white, white, white, full]),
        "mask_photograph.png": Image.fromarray(photograph),
        "mask_jpeg.jpg": white,
        "mask_soft.png": white.resize((160, 120), 2).resize((320, 240), 2),
        "labels.png": Image.fromarray(labels),
        "labels_palette.png": palette(labels, [(0, 0, 0), (200, 0, 0), (0, 200, 0)]),
        "mask_red_on_white.png": palette(target, [(255, 255, 255), (200, 0, 0)]).convert("RGB"),
        "mask_all_white.png": full,
        "mask_of_nothing.png": black,
    }
    FOLDER.mkdir(exist_ok=True)
    for name, picture in pictures.items():
        extra = {"compression": "tiff_adobe_deflate"} if name.endswith(".tif") else {}
        picture.save(FOLDER / name, **extra)
    black_red.save(FOLDER / "mask_transparent_palette.png", transparency=0)
    np.savez_compressed(FOLDER / "view.npz", depth=depth, mask=target, K=K)
    grey = np.repeat(millimetres[..., None], 3, -1)
    write_deep_colour(FOLDER / "depth_16_bits_thrice.png", grey)
    write_deep_colour(FOLDER / "depth_16_bits_colour.png", grey // np.array([1, 2, 3], np.uint16))
    torn = (FOLDER / "depth_16_bits.png").read_bytes()
    (FOLDER / "torn.png").write_bytes(torn[: len(torn) // 2])


if __name__ == "__main__":
    main()
