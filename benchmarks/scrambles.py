"""Captures made wrong on purpose: cameras in another order or of other axes, photos that give no scene."""

from collections.abc import Callable, Iterator

import cv2
import numpy as np

from inpaint3d.contracts.models.artifacts import CapturedFrame
from inpaint3d.scene.cameras import as_pose

Frames = list[CapturedFrame]
Scramble = Callable[[Frames], Frames]
Pictures = list[np.ndarray]

# Cameras, scrambled: poses are world_from_cam.


def _with_poses(frames: Frames, change: Callable[[int, np.ndarray], np.ndarray]) -> Frames:
    poses = [np.array(f.camera.world_from_cam) if f.camera else np.eye(4)[:3] for f in frames]
    moved = [as_pose(change(i, pose)) for i, pose in enumerate(poses)]
    return [
        f.model_copy(update={"camera": f.camera.model_copy(update={"world_from_cam": pose})}) if f.camera else f
        for f, pose in zip(frames, moved, strict=True)
    ]


def _reorder(order: Callable[[int], list[int]]) -> Scramble:
    def scramble(frames: Frames) -> Frames:
        chosen = order(len(frames))
        return [f.model_copy(update={"camera": frames[i].camera}) for f, i in zip(frames, chosen, strict=True)]

    return scramble


def _scale_focal(factor: float) -> Scramble:
    def scramble(frames: Frames) -> Frames:
        changed: Frames = []
        for f in frames:
            camera = f.camera
            if camera is not None:
                count = 1 if camera.model.startswith("SIMPLE") or camera.model == "RADIAL" else 2
                params = (*(p * factor for p in camera.params[:count]), *camera.params[count:])
                camera = camera.model_copy(update={"params": params})
            changed.append(f.model_copy(update={"camera": camera}))
        return changed

    return scramble


def _turn(pose: np.ndarray, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    return np.concatenate([left @ pose[:, :3] @ right, left @ pose[:, 3:]], 1)


MIRROR, OPENGL = np.diag([-1.0, 1, 1]), np.diag([1.0, -1, -1])
QUARTER = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
SCRAMBLED_CAMERAS: dict[str, Scramble] = {
    "cameras in the order of names as text": _reorder(lambda n: sorted(range(n), key=lambda i: f"f_{i}")),
    "each the next one's camera": _reorder(lambda n: [(i + 1) % n for i in range(n)]),
    "cameras shuffled": _reorder(lambda n: np.random.default_rng(0).permutation(n).tolist()),
    "mirrored poses": lambda frames: _with_poses(frames, lambda _, p: _turn(p, MIRROR, MIRROR)),
    "OpenGL's axes": lambda frames: _with_poses(frames, lambda _, p: _turn(p, np.eye(3), OPENGL)),
    "focal length 30 % too long": _scale_focal(1.3),
    "focal length 30 % too short": _scale_focal(0.7),
    "one camera turned by 90 degrees": lambda frames: _with_poses(
        frames, lambda i, p: _turn(p, np.eye(3), QUARTER) if i == len(frames) // 2 else p
    ),
    "one camera far away": lambda frames: _with_poses(frames, lambda i, p: _far(p) if i == len(frames) // 2 else p),
}


def _far(pose: np.ndarray) -> np.ndarray:
    """Backwards by 100 times its distance from the origin."""
    behind = 100 * max(1.0, float(np.linalg.norm(pose[:, 3])))
    return np.concatenate([pose[:, :3], pose[:, 3:] - behind * pose[:, 2:3]], 1)


# Pictures, scrambled.


def mix_scenes(pictures: Pictures, other: Pictures) -> Pictures:
    """Every second picture replaced by one of another scene, brought to its size."""
    mixed = list(pictures)
    for i in range(1, len(pictures), 2):
        height, width = pictures[i].shape[:2]
        mixed[i] = cv2.resize(other[i // 2 % len(other)], (width, height), interpolation=cv2.INTER_AREA)
    return mixed


def degenerate_photos(pictures: Pictures) -> Iterator[tuple[str, Pictures]]:
    """(what, pictures) of captures that no depth can be told from."""
    height, width = pictures[0].shape[:2]
    yield "two photos", pictures[:2]
    yield "pure rotation", [_warped(pictures[0], _rotation(width, height, a)) for a in np.linspace(-12, 12, 9)]
    yield "the camera at rest, an object moving", [_pasted(pictures[0], i) for i in range(9)]
    yield "no texture", [cv2.GaussianBlur(p, (0, 0), width / 8) for p in pictures[:12]]
    yield "black frames", [np.zeros_like(p) if i % 2 else p for i, p in enumerate(pictures[:16])]


def _rotation(width: int, height: int, degrees: float) -> np.ndarray:
    k = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1.0]])
    turn, _ = cv2.Rodrigues(np.deg2rad([0.3 * degrees, degrees, 0]))
    return k @ turn @ np.linalg.inv(k)


def _warped(picture: np.ndarray, homography: np.ndarray) -> np.ndarray:
    height, width = picture.shape[:2]
    turned = cv2.warpPerspective(picture, homography, (width, height), borderMode=cv2.BORDER_REFLECT)
    y, x = height // 5, width // 5
    return np.ascontiguousarray(turned[y : height - y, x : width - x])


def _pasted(picture: np.ndarray, step: int) -> np.ndarray:
    height, width = picture.shape[:2]
    shown = picture.copy()
    h, w = height // 4, width // 4
    left = width // 10 + step * w // 4
    shown[height // 2 : height // 2 + h, left : left + w] = picture[:h, :w][:, ::-1]
    noise = np.random.default_rng(step).normal(0, 0.01, shown.shape)
    return np.clip(shown + noise, 0, 1).astype(np.float32)
