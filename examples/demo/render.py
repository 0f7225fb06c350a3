"""Render the demo capture: `python examples/demo/render.py --seed 7`. Resumes where it stopped; see README.md.

Needs the `render` dependency group (Mitsuba 3), OpenImageIO, and for the default variant an LLVM library named by
DRJIT_LIBLLVM_PATH. Nothing here is read by the pipeline.
"""

from __future__ import annotations  # Mitsuba's classes have no names before a variant is chosen

import argparse
import json
import time
from fractions import Fraction
from pathlib import Path

import mitsuba as mi
import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its own documentation's name
from denoise import denoise
from phone import (
    F_NUMBER,
    NOMINAL_EXPOSURE_S,
    NOMINAL_ISO,
    PHONE,
    Lens,
    Shot,
    develop,
    exif,
    pixel_rays,
    shots,
)

HERE = Path(__file__).resolve().parent
STRATA = 4  # samples of one pass: STRATA^2 in a jittered grid over the pixel
DEPTH_EVERY = 10
FAR = 100.0
"""Distance of what a ray that lands nowhere sees, metres."""


def jitter(rng: np.random.Generator, lens: Lens) -> np.ndarray:
    """Sample places within each pixel [h, w, STRATA^2, 2] in [0, 1), one in each cell of a grid."""
    cell = np.stack(np.meshgrid(np.arange(STRATA), np.arange(STRATA)), -1).reshape(-1, 2)
    return (cell + rng.random((lens.height, lens.width, STRATA**2, 2))) / STRATA


def rays(shot: Shot, offsets: np.ndarray, lens: Lens = PHONE) -> mi.RayDifferential3f:
    origin, directions = pixel_rays(shot, offsets, lens)
    return mi.RayDifferential3f(
        mi.Point3f(*map(float, origin)), mi.Vector3f(directions.reshape(-1, 3).T.astype(np.float32))
    )


def first_surface(scene: mi.Scene, ray: mi.RayDifferential3f) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Diffuse colour [n, 3], normal [n, 3] and distance [n] where each ray first lands; none: no normal, FAR away."""
    hit = scene.ray_intersect(ray)
    colour = hit.bsdf().eval_diffuse_reflectance(hit, hit.is_valid())
    # A ray may slip through the seam of two walls, and a lathe has no normal at its poles.
    normal = np.array(hit.n).T
    return np.array(colour).T, np.where(np.isfinite(normal), normal, 0), np.minimum(np.array(hit.t), FAR)


def path_trace(scene: mi.Scene, shot: Shot, spp: int, seed: int, lens: Lens = PHONE) -> np.ndarray:
    """Denoised linear radiance [h, w, 3] as float16."""
    height, width = lens.height, lens.width
    rng = np.random.default_rng(seed)
    integrator = mi.load_dict({"type": "path", "max_depth": 5, "rr_depth": 4})
    sampler = mi.load_dict({"type": "independent"})
    batches, features = [], None
    for index in range(max(spp // STRATA**2, 1)):
        ray = rays(shot, jitter(rng, lens), lens)
        sampler.seed(seed * 1000 + index, height * width * STRATA**2)
        colour, _, _ = integrator.sample(scene, sampler, ray)
        light = np.array(colour).T
        # Meshes turned on a lathe have no normal at their poles: such a sample carries no light.
        light = np.where(np.isfinite(light).all(-1, keepdims=True), light, 0.0)
        # fireflies: one sample may not outshine the lamps that it comes from
        batches.append(np.minimum(light, 6.0).reshape(height, width, -1, 3))
        if features is None:
            features = [part.reshape(height, width, STRATA**2, -1).mean(2) for part in first_surface(scene, ray)]
    samples = np.concatenate(batches, axis=2)
    luminance = samples.mean(-1)
    albedo, normal, depth = features
    variance = luminance.var(axis=2) / luminance.shape[2]
    return denoise(samples.mean(2), variance, albedo, normal, depth[..., 0]).astype(np.float16)


def geometry(scenes: dict[str, mi.Scene], shot: Shot) -> tuple[np.ndarray, np.ndarray]:
    """The object's mask (most of the pixel covered), and depth along the axis at pixel centres, metres; [h, w]."""
    height, width = PHONE.height, PHONE.width
    grid = (np.stack(np.meshgrid(np.arange(4), np.arange(4)), -1).reshape(-1, 2) + 0.5) / 4
    ray = rays(shot, np.broadcast_to(grid, (height, width, 16, 2)))
    everything, thing = (np.array(scenes[name].ray_intersect_preliminary(ray).t) for name in ("with", "object"))
    visible = np.isfinite(thing) & (thing <= everything + 1e-4)
    centre = np.full((height, width, 1, 2), 0.5)
    distance = np.array(scenes["with"].ray_intersect_preliminary(rays(shot, centre)).t)
    _, directions = pixel_rays(shot, centre)
    along = (directions @ shot.world_from_cam[:, 2])[..., 0]
    return visible.reshape(height, width, 16).mean(-1) > 0.5, distance.reshape(height, width) * along


def write_picture(path: Path, pixels: np.ndarray, attributes: dict | None = None) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    kind = "half" if path.suffix == ".exr" else "uint8"
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], kind)
    if path.suffix == ".exr":
        spec.channelnames = ("depth.Z",)
        spec.attribute("compression", "zip")
    for name, value in (attributes or {}).items():
        spec.attribute(name, value)
    out = oiio.ImageOutput.create(str(path))
    if not (out and out.open(str(path), spec) and out.write_image(np.ascontiguousarray(pixels)) and out.close()):
        raise OSError(f"cannot write {path}: {oiio.geterror()}")


def write_photo(path: Path, pixels: np.ndarray, shot: Shot) -> None:
    """A JPEG with the EXIF of a phone: the exposure that the picture really had."""
    seconds, iso = exif(shot)
    attributes = {
        "Compression": "jpeg:90", "Make": "Path traced", "Model": "Demo phone", "Orientation": 1,
        "ExposureTime": float(seconds), "FNumber": F_NUMBER, "Exif:PhotographicSensitivity": iso,
        "Exif:FocalLengthIn35mmFilm": 29, "Exif:FocalLength": 4.8,
    }  # fmt: skip
    write_picture(path, pixels, attributes)


def camera_record(shot: Shot) -> dict:
    seconds, iso = exif(shot)
    return {
        "name": shot.name,
        "world_from_cam": np.round(shot.world_from_cam, 9).tolist(),
        "exposure_ev": round(shot.exposure_ev, 6),
        "exposure_s": round(seconds, 9),
        "iso": iso,
    }


def write_cameras(path: Path, taken: list[Shot], shown: list[Shot], seed: int) -> None:
    record = {
        "about": "OpenCV cameras, metres, z up; pixel centres at +0.5; "
        "SIMPLE_RADIAL as COLMAP defines it: f, cx, cy, k",
        "seed": seed,
        "width": PHONE.width,
        "height": PHONE.height,
        "model": "SIMPLE_RADIAL",
        "params": [PHONE.focal_px, PHONE.width / 2, PHONE.height / 2, PHONE.k1],
        "nominal": {
            "exposure_s": str(Fraction(NOMINAL_EXPOSURE_S).limit_denominator(1000)),
            "iso": NOMINAL_ISO,
            "f_number": F_NUMBER,
        },
        "images": [camera_record(shot) for shot in taken],
        "truth": [camera_record(shot) for shot in shown],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(record, indent=1) + "\n")


def radiance_of(scene: mi.Scene, shot: Shot, spp: int, seed: int, cache: Path) -> np.ndarray:
    """From the cache if it is there (a render cut short goes on), else traced and cached."""
    path = cache / f"{shot.name}_{spp}.npy"
    if not path.exists():
        started = time.perf_counter()
        radiance = path_trace(scene, shot, spp, seed)
        part = path.with_suffix(".part")
        with part.open("wb") as file:
            np.save(file, radiance)
        part.rename(path)
        print(
            f"{shot.name}: {spp} spp, wall {time.perf_counter() - started:.1f} s, cpu {time.process_time():.0f} s",
            flush=True,
        )
    return np.load(path)


def render_clean(scene: mi.Scene, taken: list[Shot], options: argparse.Namespace) -> None:
    """What the photos would have been without the figure: their cameras, exposures and noise."""
    cache = options.cache / "clean"
    cache.mkdir(parents=True, exist_ok=True)
    for index, shot in enumerate(taken):
        if options.only and shot.name not in options.only:
            continue
        radiance = radiance_of(scene, shot, options.spp, options.seed * 10_000 + index, cache)
        pixels = develop(radiance, shot, np.random.default_rng([options.seed, 200, index]), noise=options.noise)
        write_picture(options.out / "renderer/clean" / f"{shot.name}.png", pixels)


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--spp", type=int, default=16, help="samples per pixel, a multiple of 16")
    parser.add_argument("--frames", type=int, default=50)
    parser.add_argument("--truths", type=int, default=20)
    parser.add_argument("--only", nargs="*", help="names of views, for a preview")
    parser.add_argument("--out", type=Path, default=HERE)
    parser.add_argument("--cache", type=Path, default=HERE / ".cache", help="linear pictures, kept between runs")
    parser.add_argument(
        "--clean",
        action="store_true",
        help="the photos' own views without the figure, to `renderer/clean`; for studies",
    )
    parser.add_argument("--noise", type=float, default=1.0, help="with --clean: share of a photo's noise")
    parser.add_argument("--variant", default="llvm_ad_rgb")
    return parser.parse_args()


def main() -> None:
    options = parse()
    mi.set_variant(options.variant)
    import scene as room

    scenes = room.build(options.seed)
    taken, shown = shots(options.seed, options.frames, options.truths, np.array([0.0, 0.0, room.TABLE_TOP + 0.17]))
    options.cache.mkdir(parents=True, exist_ok=True)
    if options.clean:
        render_clean(scenes["without"], taken, options)
        return
    write_cameras(options.out / "renderer/cameras.json", taken, shown, options.seed)
    for index, shot in enumerate(taken + shown):
        if options.only and shot.name not in options.only:
            continue
        truth = index >= len(taken)
        radiance = radiance_of(
            scenes["without" if truth else "with"], shot, options.spp, options.seed * 10_000 + index, options.cache
        )
        pixels = develop(
            radiance, shot, np.random.default_rng([options.seed, 200, index]), noise=0.25 if truth else 1.0
        )
        write_photo(options.out / "capture" / ("truth" if truth else "images") / f"{shot.name}.jpg", pixels, shot)
        if not truth:
            mask, depth = geometry(scenes, shot)
            write_picture(options.out / "renderer/masks" / f"{shot.name}.png", np.where(mask, 255, 0).astype(np.uint8))
            if index % DEPTH_EVERY == 0:
                write_picture(options.out / "renderer/depth" / f"{shot.name}.exr", depth.astype(np.float32))


if __name__ == "__main__":
    main()
